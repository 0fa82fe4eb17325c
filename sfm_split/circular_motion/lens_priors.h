#pragma once

#include <vector>

#include "sfm_split/circular_motion/circular_likelihood.h"
#include "sfm_split/scene/focal_prior.h"
#include "sfm_split/scene/scene.h"

namespace s2gs {

/// k of r (1 + k r^2) as the camera has it; 0 where its model has none.
double DistortionOf(const Camera& camera);

/// What is known before the matches of a fit's lenses, cameras[i] by lens_priors[i]: focal lengths within
/// their bounds, and distortion, which is held at the camera's or has kDistortionSigma about it.
CircularPriors PriorsOfLenses(const std::vector<Camera>& cameras, const std::vector<FocalPrior>& lens_priors,
                              bool with_distortion);

}  // namespace s2gs
