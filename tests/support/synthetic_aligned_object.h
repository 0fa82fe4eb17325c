#pragma once

#include "sfm_split/turntable/align_scene.h"
#include "tests/support/synthetic_models.h"
#include "tests/support/synthetic_turntable.h"

namespace s2gs {

/// The exact scene with the rotating part's model (SyntheticObjectModel) and none of the background.
inline AlignedScene SyntheticAlignedObject(const SyntheticTurntable& turntable) {
  AlignedScene aligned;
  aligned.scene = turntable.scene;
  aligned.object = SyntheticObjectModel(turntable);
  return aligned;
}

}  // namespace s2gs
