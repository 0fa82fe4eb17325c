#include "sfm_split/scene/focal_prior.h"

#include <algorithm>
#include <cmath>

namespace s2gs {
namespace {

constexpr double kUsualFocalShare = 1.2;  // of the longer side
constexpr double kUsualSigma = 0.44;      // half of log(2.9 / 1.2)
constexpr double kExifSigma = 0.05;       // of its logarithm: what focusing lengthens
constexpr double kWrongExif = 0.1;        // a judgement: one set of photos in ten

double LongerSide(const Camera& camera) { return static_cast<double>(std::max(camera.width, camera.height)); }

double LogOf(const FocalNormal& normal, double log_focal) {
  const double off = (log_focal - std::log(normal.focal_px)) / normal.sigma_log;
  return -0.5 * off * off;
}

// Of the density at `otherwise`'s mean over that at what is stated.
double LogPeakOtherwise(const FocalPrior& prior) {
  return std::log(kWrongExif / (1 - kWrongExif) * prior.likeliest.sigma_log / prior.otherwise->sigma_log);
}

}  // namespace

const FocalNormal& FocalPrior::At(double log_focal) const {
  if (!otherwise) return likeliest;
  const double of_otherwise = LogPeakOtherwise(*this) + LogOf(*otherwise, log_focal);
  return LogOf(likeliest, log_focal) >= of_otherwise ? likeliest : *otherwise;
}

double FocalPrior::LogDensity(double log_focal) const {
  const FocalNormal& normal = At(log_focal);
  return LogOf(normal, log_focal) + (&normal == &likeliest ? 0 : LogPeakOtherwise(*this));
}

FocalPrior FocalPriorOf(const Camera& camera, bool is_from_exif) {
  const double given = FocalLengths(camera).mean();
  const FocalNormal usual{kUsualFocalShare * LongerSide(camera), kUsualSigma};
  if (is_from_exif && IsPlausibleFocal(camera, given)) return {{given, kExifSigma}, usual};
  return {usual, std::nullopt};
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
  double sum = FocalPriorOf(given, is_from_exif).LogDensity(std::log(FocalLengths(camera).mean()));
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
