#pragma once

#include "s2gs/backend.h"
#include "s2gs/image_error.h"
#include "s2gs/training_scene.h"

namespace s2gs {

/// What to render for the mask of the rotating part. Static Gaussians where the rotating part sweeps are left
/// out: nothing that stands still can be there, so that they are shadows or reflections that keep their place
/// while the surface moves on below them. Static ones elsewhere may stand before the rotating part and hide
/// it. In photos of a single station the depth of what stands still cannot be observed: all of it is taken to
/// be behind.
RenderRequest MaskRequest(const TrainingScene& scene, const PinholeView& view);

/// The pixels where the map of the indicator p >= tau is above one half.
PixelMask RotatingMask(const RenderedView& view);

}  // namespace s2gs
