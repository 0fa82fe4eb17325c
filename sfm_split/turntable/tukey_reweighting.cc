#include "sfm_split/turntable/tukey_reweighting.h"

#include <algorithm>

#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

double TukeyWeight(double ratio) {
  const double u = 1 - ratio * ratio;
  return u > 0 ? u * u : 0;
}

}  // namespace

std::vector<double> TukeyReweighting::operator()(const std::vector<double>& residuals) {
  std::vector<double> within;
  for (const double r : residuals) {
    if (r <= inlier_sigmas * sigma) within.push_back(r);
  }
  if (!within.empty()) {
    const int redundancy = std::max(1, coordinates * static_cast<int>(within.size()) - parameters);
    sigma = std::max((1 + 5.0 / redundancy) * UpperMedian(within) / median_of_unit, floor);
  }
  std::vector<double> weights;
  weights.reserve(residuals.size());
  for (const double r : residuals) weights.push_back(TukeyWeight(r / (2 * inlier_sigmas * sigma)));
  return weights;
}

}  // namespace s2gs
