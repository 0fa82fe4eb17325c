#include "sfm_split/evidence/match_noise.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

#include "tests/support/synthetic_scan.h"
#include "tests/support/synthetic_turntable.h"

namespace s2gs {
namespace {

std::vector<double> Errors(double sigma, double inlier_share, double range, uint32_t seed) {
  std::mt19937 rng(seed);
  std::normal_distribution<double> normal(0, sigma);
  std::uniform_real_distribution<double> uniform(0, 1);
  std::vector<double> errors;
  for (int k = 0; k < 20000; ++k) {
    errors.push_back(uniform(rng) < inlier_share ? normal(rng) : range * uniform(rng));
  }
  return errors;
}

TEST(MatchNoise, FindsTheSpreadWhateverTheOutliers) {
  for (const double sigma : {0.2, 0.5, 1.0, 3.0, 6.0}) {
    for (const double share : {0.3, 0.6, 0.95}) {
      const NoiseFit fit = FitNoise(Errors(sigma, share, 24, 7), 24);
      // Measured: within 3.2 % and 0.011.
      EXPECT_NEAR(fit.sigma, sigma, 0.05 * sigma) << sigma << " " << share;
      EXPECT_NEAR(fit.inlier_share, share, 0.02) << sigma << " " << share;
    }
  }
}

TEST(MatchNoise, LeavesOutWhatIsNoError) {
  std::vector<double> errors = Errors(0.5, 0.8, 24, 3);
  const NoiseFit clean = FitNoise(errors, 24);
  errors.insert(errors.end(), 1000, std::numeric_limits<double>::infinity());
  errors.insert(errors.end(), 1000, std::numeric_limits<double>::quiet_NaN());
  errors.insert(errors.end(), 1000, 1e9);
  const NoiseFit fit = FitNoise(errors, 24);
  EXPECT_EQ(fit.sigma, clean.sigma);
  EXPECT_EQ(fit.inlier_share, clean.inlier_share);
  EXPECT_EQ(FitNoise({}, 24).sigma, 0);
  EXPECT_GT(FitNoise({0, 0, 0}, 24).sigma, 0);
}

TEST(MatchNoise, IsThatOfAKeypointsCoordinate) {
  SyntheticTurntableOptions options;
  options.stations = 2;
  options.steps = 8;
  options.max_view_change_deg = 60;
  options.pixel_noise = 1.5;
  options.outlier_share = 0.3;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  const ScanFeatures features = SyntheticScanFeatures(turntable);
  const std::vector<PosedImage> posed = TruePosesOfObject(turntable);
  const MatchErrors errors(posed, AllKeypoints(features));
  const NoiseFit fit = MeasureMatchNoise(posed, errors, features.object_pairs, 24);
  EXPECT_NEAR(fit.sigma, 1.5, 0.05);  // measured 1.50
  // Every other match tells nearly the same.
  EXPECT_NEAR(MeasureMatchNoise(posed, errors, features.object_pairs, 24, 5000).sigma, 1.5, 0.1);
}

}  // namespace
}  // namespace s2gs
