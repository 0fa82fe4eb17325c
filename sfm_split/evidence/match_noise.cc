#include "sfm_split/evidence/match_noise.h"

#include <algorithm>
#include <cmath>

namespace s2gs {
namespace {

constexpr int kMaxIterations = 200;              // of expectation and maximisation
constexpr double kSqrt2 = 1.41421356237309505;   // of the error function's argument
constexpr double kSqrtPi = 1.77245385090551603;  // of the normal density

}  // namespace

NoiseFit FitNoise(const std::vector<double>& errors, double range) {
  std::vector<double> within;
  within.reserve(errors.size());
  for (const double error : errors) {
    if (std::abs(error) <= range) within.push_back(std::abs(error));
  }
  NoiseFit fit;
  if (within.empty()) return fit;
  fit.sigma = range / 10;
  fit.inlier_share = 0.5;
  for (int iteration = 0; iteration < kMaxIterations; ++iteration) {
    const double scale = fit.sigma * kSqrt2;
    const double peak = fit.inlier_share * 2 / (scale * kSqrtPi * std::erf(range / scale));
    const double flat = (1 - fit.inlier_share) / range;
    double sum = 0;
    double squares = 0;
    for (const double error : within) {
      const double noise = peak * std::exp(-error * error / (scale * scale));
      const double share = noise / (noise + flat);
      sum += share;
      squares += share * error * error;
    }
    const double before = fit.sigma;
    fit.inlier_share = std::clamp(sum / static_cast<double>(within.size()), 1e-6, 1 - 1e-6);
    fit.sigma = std::clamp(std::sqrt(squares / std::max(sum, 1e-12)), 1e-9 * range, range / 3);
    if (std::abs(fit.sigma - before) <= 1e-4 * before) break;
  }
  return fit;
}

NoiseFit MeasureMatchNoise(const std::vector<PosedImage>& images, const MatchErrors& errors,
                           const std::vector<ImagePairMatches>& pairs, double range_px, size_t max_matches) {
  const auto are_posed = [&](const ImagePairMatches& pair) {
    return images[static_cast<size_t>(pair.image1)].is_posed &&
           images[static_cast<size_t>(pair.image2)].is_posed;
  };
  size_t all = 0;
  for (const ImagePairMatches& pair : pairs) all += are_posed(pair) ? pair.matches.size() : 0;
  const size_t stride = std::max<size_t>(1, all / std::max<size_t>(1, max_matches));
  std::vector<ImagePairMatches> looked_at;
  size_t next = 0;
  for (const ImagePairMatches& pair : pairs) {
    if (!are_posed(pair)) continue;
    looked_at.push_back({pair.image1, pair.image2, {}});
    for (; next < pair.matches.size(); next += stride) looked_at.back().matches.push_back(pair.matches[next]);
    next -= pair.matches.size();
  }
  std::vector<double> of_all;
  of_all.reserve(all / stride + 1);
  for (const std::vector<double>& of_pair : errors.Of(looked_at))
    of_all.insert(of_all.end(), of_pair.begin(), of_pair.end());
  return FitNoise(of_all, range_px);
}

}  // namespace s2gs
