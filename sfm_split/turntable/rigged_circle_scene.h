#pragma once

#include "sfm_split/base/reporter.h"
#include "sfm_split/scene/scan_features.h"
#include "sfm_split/turntable/align_scene.h"
#include "sfm_split/turntable/rigged_circle.h"

namespace s2gs {

/// An aligned scene, without points, of all photos at stations that the background's model knows: one axis
/// for all of them and steps that close, from raw matches, right and wrong ones. Empty where the background
/// knows fewer than two stations, or the matches do not tell one circle. \param sigma_px  of a right match's
/// epipolar error. Throws Interrupted when the reporter asks to stop.
AlignedScene SceneFromRiggedCircle(const ScanFeatures& features, const ColmapModel& background,
                                   double sigma_px, Reporter& reporter, RiggedCircle* circle);

}  // namespace s2gs
