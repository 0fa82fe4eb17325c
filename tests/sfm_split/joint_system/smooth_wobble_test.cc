#include "sfm_split/joint_system/smooth_wobble.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <random>
#include <vector>

#include "sfm_split/adjust/joint_model.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/joint_system/joint_system.h"
#include "tests/sfm_split/joint_system/wobbling_scan.h"

namespace s2gs {
namespace {

using Eigen::Vector3d;

constexpr double kTilt = 0.3 * kDegree;

// The table tilts by kTilt once and by half of that twice a turn, about two ways across the axis.
WobbleOfPose Smooth(double angle) {
  WobbleOfPose wobble;
  wobble.tilt_rad = kTilt * Vector3d(std::cos(angle + 0.4) + 0.5 * std::sin(2 * angle),
                                     std::sin(angle + 1.1) - 0.5 * std::cos(2 * angle), 0);
  wobble.shift = 0.02 * Vector3d(wobble.tilt_rad.y(), -wobble.tilt_rad.x(), 0);
  return wobble;
}

WobblingScan SmoothScan(uint32_t seed, int few, bool does_wobble = true) {
  std::mt19937 rng(seed);
  std::normal_distribution<double> normal;
  return MakeWobblingScan(
      seed, few, [&] { return normal(rng); },
      [&](size_t, double angle) { return does_wobble ? Smooth(angle) : WobbleOfPose(); });
}

JointOptions Options() {
  JointOptions options;
  options.refine_focal_length = options.refine_extra_params = false;
  options.loss_scale_px = LossScalePx(WobblingScan::kNoisePx);
  options.num_threads = 2;
  return options;
}

// Largest and median error of the poses' rotations, which are told against the reference's [degrees].
std::pair<double, double> RotationErrors(const WobblingScan& scan, const JointProblem& adjusted) {
  std::vector<double> errors;
  for (size_t i = 0; i < adjusted.images.size(); ++i) {
    const Rigid3 found = adjusted.WorldFromObject(static_cast<int>(i));
    errors.push_back(AngleBetween(found.rotation, scan.world_from_object[i].rotation) / kDegree);
  }
  return {*std::max_element(errors.begin(), errors.end()), UpperMedian(errors)};
}

TEST(SmoothWobble, TheTermsAreThoseOfOneAndTwoTurns) {
  WobbleHarmonics wobble;
  wobble.coefficients.row(3) << 1, 2, 3, 4, 5;
  const double angle = 0.7;
  const WobbleHarmonics::Parts at = wobble.At(angle);
  EXPECT_NEAR(
      at(3),
      1 + 2 * std::cos(angle) + 3 * std::sin(angle) + 4 * std::cos(2 * angle) + 5 * std::sin(2 * angle),
      1e-15);
  EXPECT_EQ(at(0), 0);
}

// What goes round twice a turn is no matter of where the axis lies, nor of how the reference's pose errs.
TEST(SmoothWobble, HarmonicsAreThoseOfTheTable) {
  WobblingScan scan = SmoothScan(3, 1000);
  JointOptions options = Options();
  options.model = JointModel::kWobblingTable;
  Reporter reporter;
  const JointReport report = AdjustJointly(options, reporter, &scan.problem);
  EXPECT_EQ(report.model, JointModel::kWobblingTable);
  ASSERT_TRUE(scan.problem.priors.wobble.has_value());
  ASSERT_EQ(scan.problem.priors.wobble->harmonics.size(), 1U);
  const WobbleHarmonics& wobble = scan.problem.priors.wobble->harmonics[0];
  const double twice = wobble.coefficients.block<2, 2>(0, 3).norm();
  EXPECT_NEAR(twice, kTilt * std::sqrt(0.5), 0.1 * kTilt);
  EXPECT_LT(scan.problem.priors.wobble->sigma_tilt_rad, 0.1 * kTilt);
}

// Each of a tilt's five coefficients is half of kTilt in the root of the mean of squares.
TEST(SmoothWobble, HarmonicsAreAsLargeAsTheyTurnOutToBe) {
  JointOptions options = Options();
  options.model = JointModel::kWobblingTable;
  Reporter reporter;
  WobblingScan wobbling = SmoothScan(5, 12, true);
  AdjustJointly(options, reporter, &wobbling.problem);
  const WobblePrior& found = *wobbling.problem.priors.wobble;
  EXPECT_NEAR(found.sigma_harmonic_tilt_rad / kTilt, 0.5, 0.15);  // .549
  EXPECT_LT(found.sigma_tilt_rad, 0.15 * kTilt);                  // .071: there is none
  WobblingScan still = SmoothScan(5, 12, false);
  AdjustJointly(options, reporter, &still.problem);
  EXPECT_LT(still.problem.priors.wobble->sigma_harmonic_tilt_rad, 0.03 * kTilt);  // .0097
}

// Poses that lie about no turn at all, of which keypoints tell little, stay where they are.
TEST(SmoothWobble, WhatKeypointsDoNotTellStays) {
  WobblingScan scan = SmoothScan(7, 12, false);
  scan.problem = WithFreeObject(scan.problem);
  scan.problem.priors.wobble = NoWobble(scan.problem);
  ASSERT_TRUE(scan.problem.priors.wobble.has_value());
  JointOptions options = Options();
  WobblePrior& prior = *scan.problem.priors.wobble;
  prior.sigma_tilt_rad = prior.sigma_harmonic_tilt_rad = 1e-7;
  prior.sigma_shift = prior.sigma_harmonic_shift = 1e-8;
  const WobblePrior found = FitDeviations(scan.problem, options);
  EXPECT_GE(found.sigma_tilt_rad, prior.sigma_tilt_rad);
  EXPECT_GE(found.sigma_shift, prior.sigma_shift);
  EXPECT_GE(found.sigma_harmonic_tilt_rad, prior.sigma_harmonic_tilt_rad);
  EXPECT_GE(found.sigma_harmonic_shift, prior.sigma_harmonic_shift);
  // Too many unknowns to tell.
  options.max_dense_parameters = 1;
  prior.sigma_tilt_rad = 1;
  EXPECT_EQ(FitDeviations(scan.problem, options).sigma_tilt_rad, 1);
}

// Where every second photo shows few keypoints, harmonics tell how it tilts by what the others show.
TEST(SmoothWobble, FewKeypointsFollowTheOthers) {
  for (const uint32_t seed : {21U, 22U, 23U}) {
    WobblingScan scan = SmoothScan(seed, 8);
    JointProblem shared = scan.problem;
    Reporter reporter;
    JointOptions options = Options();
    options.model = JointModel::kWobblingTable;
    AdjustJointly(options, reporter, &scan.problem);
    options.model = JointModel::kSharedStations;
    AdjustJointly(options, reporter, &shared);
    const auto [most, median] = RotationErrors(scan, scan.problem);
    const auto [most_shared, median_shared] = RotationErrors(scan, shared);
    EXPECT_LT(median, 0.6 * median_shared) << seed;
    EXPECT_LT(most, most_shared) << seed;
  }
}

// What is known of a table's steps holds where its object's poses are free, too.
TEST(SmoothWobble, EqualStepsHoldFreePoses) {
  WobblingScan scan = SmoothScan(31, 7);
  JointProblem free = WithFreeObject(scan.problem);
  EqualStepsPrior steps;
  for (size_t i = 0; i < free.images.size(); ++i)
    steps.places.push_back({static_cast<int>(i), static_cast<double>(i)});
  steps.closes = true;
  steps.step_rad = 2 * kPi / 24;
  steps.sigma_rad = 0.01 * kDegree;
  JointProblem held = free;
  held.priors.turns = {steps};
  Reporter reporter;
  JointOptions options = Options();
  options.model = JointModel::kWobblingTable;
  const auto angle_errors = [&](JointProblem* problem) {
    AdjustJointly(options, reporter, problem);
    double squares = 0;
    for (size_t i = 0; i < problem->images.size(); ++i) {
      const auto angle = [&](const Rigid3& pose) {
        return AngleAbout(problem->AxisDirection(), pose.rotation.toRotationMatrix());
      };
      const double error = angle(problem->images[i].world_from_object) - angle(scan.world_from_object[i]);
      squares += std::pow(WrapAngle(error) / kDegree, 2);
    }
    return std::sqrt(squares / static_cast<double>(problem->images.size()));
  };
  EXPECT_LT(angle_errors(&held), 0.5 * angle_errors(&free));
}

}  // namespace
}  // namespace s2gs
