#include "sfm_split/circular_motion/lens_priors.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <optional>

namespace s2gs {
namespace {

void AddFocalPrior(const Camera& camera, const FocalPrior& prior, CircularPriors* priors) {
  const double side = std::log(static_cast<double>(std::max(camera.width, camera.height)));
  priors->focal.push_back(prior);
  priors->least_log_focal.push_back(side + std::log(kLeastFocalShare));
  priors->most_log_focal.push_back(side + std::log(kMostFocalShare));
}

}  // namespace

double DistortionOf(const Camera& camera) {
  const std::optional<size_t> place = DistortionPlace(camera);
  return place ? camera.params[*place] : 0;
}

CircularPriors PriorsOfLenses(const std::vector<Camera>& cameras, const std::vector<FocalPrior>& lens_priors,
                              bool with_distortion) {
  CircularPriors priors;
  for (size_t c = 0; c < cameras.size(); ++c) {
    AddFocalPrior(cameras[c], lens_priors[c], &priors);
    priors.distortion.push_back(DistortionOf(cameras[c]));
  }
  priors.distortion_sigma = with_distortion ? kDistortionSigma : 0;
  return priors;
}

}  // namespace s2gs
