#include "sfm_split/scene/focal_prior.h"

#include <algorithm>
#include <cmath>

namespace s2gs {
namespace {

constexpr double kUsualFocalShare = 1.2;  // of the longer side
constexpr double kUsualSigma = 0.44;      // half of log(2.9 / 1.2)
constexpr double kExifSigma = 0.05;       // of its logarithm: what focusing lengthens

double LongerSide(const Camera& camera) { return static_cast<double>(std::max(camera.width, camera.height)); }

}  // namespace

FocalPrior FocalPriorOf(const Camera& camera, bool is_from_exif) {
  const double given = FocalLengths(camera).mean();
  if (is_from_exif && IsPlausibleFocal(camera, given)) return {given, kExifSigma};
  return {kUsualFocalShare * LongerSide(camera), kUsualSigma};
}

std::optional<size_t> DistortionPlace(const Camera& camera) {
  switch (camera.model) {
    case CameraModelId::kSimpleRadial:
    case CameraModelId::kRadial:
    case CameraModelId::kOpenCV:
    case CameraModelId::kFullOpenCV:
      return InfoOf(camera.model).FirstExtraParam();
    default:
      return std::nullopt;
  }
}

Eigen::Vector2d PrincipalPointShift(const Camera& camera, const Eigen::Vector2d& expected_px) {
  return (PrincipalPoint(camera) - expected_px) / LongerSide(camera);
}

double LogPriorOfLens(const Camera& camera, const Camera& given, bool is_from_exif) {
  const FocalPrior prior = FocalPriorOf(given, is_from_exif);
  const double off = std::log(FocalLengths(camera).mean() / prior.focal_px) / prior.sigma_log;
  double sum = -0.5 * off * off;
  const std::optional<size_t> k = DistortionPlace(camera);
  const std::optional<size_t> given_k = DistortionPlace(given);
  if (k && given_k) {
    const double bent = (camera.params[*k] - given.params[*given_k]) / kDistortionSigma;
    sum -= 0.5 * bent * bent;
  }
  return sum;
}

bool IsPlausibleFocal(const Camera& camera, double focal_px) {
  const double share = focal_px / LongerSide(camera);
  return share >= kLeastFocalShare && share <= kMostFocalShare;
}

}  // namespace s2gs
