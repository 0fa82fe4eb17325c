#include "sfm_split/adjust/known_angles.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <optional>
#include <string>
#include <vector>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "tests/support/synthetic_aligned_object.h"
#include "tests/support/synthetic_turntable.h"

namespace s2gs {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

constexpr int kNumPhotos = 12;
constexpr double kStepDeg = 20;

struct Scan {
  JointProblem problem;
  std::vector<double> truth_rad;
  std::vector<int> stations = std::vector<int>(kNumPhotos, 0);
  JointReport report;
};

// Part of a turn, of unequal steps, adjusted without what is stated.
Scan Adjusted(uint64_t seed) {
  SyntheticTurntableOptions options;
  options.seed = seed;
  options.stations = 1;
  options.steps = kNumPhotos;
  options.step_deg = kStepDeg;
  options.step_jitter = 0.1;
  options.num_object_points = 120;
  options.num_platter_points = 20;
  options.num_background_points = 0;
  options.pixel_noise = 0.4;
  options.camera_model = CameraModelId::kSimpleRadial;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  const AlignedScene aligned = SyntheticAlignedObject(turntable);
  Scan scan;
  scan.problem = MakeJointProblem(aligned);
  for (const View& view : turntable.scene.views) {
    scan.truth_rad.push_back(WrapAngle((view.angle_deg - turntable.scene.views[0].angle_deg) * kDegree));
  }
  JointOptions joint;
  joint.model = JointModel::kSharedStations;
  Reporter reporter;
  scan.report = AdjustJointly(joint, reporter, &scan.problem);
  return scan;
}

// As another device counts them: from another angle on, in the other sense.
std::vector<std::optional<double>> Stated(const Scan& scan, double factor = 1) {
  std::vector<std::optional<double>> stated;
  for (const double truth : scan.truth_rad) stated.emplace_back(1.5 - factor * truth);
  return stated;
}

double SquaredError(const Scan& scan) {
  double sum = 0;
  for (size_t i = 0; i < scan.truth_rad.size(); ++i) {
    const double error = WrapAngle(scan.problem.images[i].angle_rad - scan.truth_rad[i]);
    sum += error * error;
  }
  return sum;
}

TEST(KnownAngles, HelpWhereTheyAreRight) {
  double before = 0;
  double after = 0;
  int within = 0;
  int all = 0;
  for (uint64_t seed = 50; seed < 58; ++seed) {
    Scan scan = Adjusted(seed);
    before += SquaredError(scan);
    const std::vector<KnownAngles> angles =
        CompareKnownAngles(scan.problem, scan.stations, Stated(scan), scan.report);
    ASSERT_EQ(angles.size(), 1U);
    EXPECT_TRUE(angles[0].is_believed);
    EXPECT_TRUE(angles[0].contradicts.empty());
    EXPECT_EQ(angles[0].prior.step_rad, -1);
    scan.problem.priors.turns = {angles[0].prior};
    scan.problem.priors.data_inflation = DataInflation(scan.problem, scan.report);
    JointOptions joint;
    joint.model = JointModel::kSharedStations;
    Reporter reporter;
    scan.report = AdjustJointly(joint, reporter, &scan.problem);
    after += SquaredError(scan);
    EXPECT_GT(AnglePriorShare(scan.report).value_or(0), 0.05);
    for (size_t i = 0; i < scan.truth_rad.size(); ++i) {
      if (!(scan.report.angle_sigma_deg[i] > 0)) continue;
      const double error = WrapAngle(scan.problem.images[i].angle_rad - scan.truth_rad[i]) / kDegree;
      within += std::abs(error) <= 2 * scan.report.angle_sigma_deg[i] ? 1 : 0;
      ++all;
    }
  }
  RecordProperty("ratio", std::to_string(std::sqrt(after / before)));
  RecordProperty("within", std::to_string(static_cast<double>(within) / all));
  EXPECT_LT(after, 0.8 * before);
  EXPECT_GE(within, 0.9 * all);
}

TEST(KnownAngles, OneThatIsWrongIsNamedAndLeftOut) {
  const Scan scan = Adjusted(60);
  std::vector<std::optional<double>> stated = Stated(scan);
  *stated[5] += 40 * kDegree;
  stated[7].reset();
  const std::vector<KnownAngles> angles =
      CompareKnownAngles(scan.problem, scan.stations, stated, scan.report);
  ASSERT_EQ(angles.size(), 1U);
  EXPECT_TRUE(angles[0].is_believed);
  EXPECT_THAT(angles[0].contradicts, ElementsAre(5));
  EXPECT_EQ(angles[0].prior.places.size(), kNumPhotos - 2U);
  EXPECT_THAT(DescribeContradiction(angles[0], scan.problem).value_or(""),
              HasSubstr("(" + scan.problem.images[5].name + "). The rest scatter by "));
}

TEST(KnownAngles, ThoseOfOtherPhotosAreNotBelieved) {
  const Scan scan = Adjusted(61);
  std::vector<std::optional<double>> stated = Stated(scan);
  const std::vector<std::optional<double>> right = stated;
  for (size_t i = 0; i < stated.size(); ++i) stated[i] = right[i * 5 % stated.size()];
  const std::vector<KnownAngles> angles =
      CompareKnownAngles(scan.problem, scan.stations, stated, scan.report);
  ASSERT_EQ(angles.size(), 1U);
  EXPECT_FALSE(angles[0].is_believed);
  EXPECT_THAT(DescribeContradiction(angles[0], scan.problem).value_or(""), HasSubstr("were not used"));
}

// Stated 1 % too small: within half a step everywhere, and told by the trend.
TEST(KnownAngles, AWrongStepIsNamed) {
  const Scan scan = Adjusted(62);
  const std::vector<KnownAngles> right =
      CompareKnownAngles(scan.problem, scan.stations, Stated(scan), scan.report);
  EXPECT_FALSE(DescribeContradiction(right[0], scan.problem).has_value());
  const std::vector<KnownAngles> wrong =
      CompareKnownAngles(scan.problem, scan.stations, Stated(scan, 0.99), scan.report);
  ASSERT_EQ(wrong.size(), 1U);
  EXPECT_NEAR(wrong[0].factor, 1 / 0.99, 5 * wrong[0].factor_sigma);
  EXPECT_THAT(DescribeContradiction(wrong[0], scan.problem).value_or(""), HasSubstr("is the step right?"));
  // It is wide enough for what it is wrong by.
  EXPECT_GT(wrong[0].prior.sigma_rad, 0.5 * wrong[0].scatter_rad);
  EXPECT_GT(wrong[0].scatter_rad, 0.3 * kDegree);
}

}  // namespace
}  // namespace s2gs
