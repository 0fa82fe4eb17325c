#include "sfm_split/joint_system/joint_priors.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <map>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "sfm_split/adjust/equal_steps.h"
#include "sfm_split/adjust/joint_ba.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/joint_system/joint_system.h"
#include "sfm_split/scene/focal_prior.h"
#include "tests/support/synthetic_aligned_object.h"
#include "tests/support/synthetic_models.h"
#include "tests/support/synthetic_turntable.h"

namespace s2gs {
namespace {

struct Scan {
  JointProblem problem;
  std::vector<CapturePlace> places;
  std::vector<double> truth_rad;  // per image, 0 at the reference
};

Scan MakeScan(uint64_t seed, double step_jitter, double pixel_noise = 0.4, int steps = 18) {
  SyntheticTurntableOptions options;
  options.seed = seed;
  options.stations = 1;
  options.steps = steps;
  options.step_deg = 20;
  options.step_jitter = step_jitter;
  options.num_object_points = 120;
  options.num_platter_points = 20;
  options.num_background_points = 0;
  options.pixel_noise = pixel_noise;
  options.camera_model = CameraModelId::kSimpleRadial;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  const AlignedScene aligned = SyntheticAlignedObject(turntable);
  Scan scan;
  scan.problem = MakeJointProblem(aligned);
  for (size_t i = 0; i < turntable.images.size(); ++i) {
    scan.places.push_back({0, turntable.images[i].step, steps});
    scan.truth_rad.push_back(
        WrapAngle((turntable.scene.views[i].angle_deg - turntable.scene.views[0].angle_deg) * kDegree));
  }
  return scan;
}

JointOptions Shared() {
  JointOptions options;
  options.model = JointModel::kSharedStations;
  return options;
}

// A normal prior on one parameter, added to normal data: Woodbury's formula on the covariance without it.
TEST(JointPriors, CovarianceIsThatOfDataAndPriorTogether) {
  Scan scan = MakeScan(1, 0);
  JointOptions options = Shared();
  options.loss = JointLoss::kSquared;
  constexpr double kSigmaPx = 0.4;
  options.loss_scale_px = LossScalePx(kSigmaPx);
  const Observability without = AnalyzeObservability(scan.problem, options, true, kSigmaPx);
  const double focal = scan.problem.cameras[0].params[0];
  LensPrior lens;
  lens.focal = {{focal, 0.002}, {}};
  scan.problem.priors.lenses = {lens};
  const Observability with = AnalyzeObservability(scan.problem, options, true, kSigmaPx);
  const auto place = std::find(without.names.begin(), without.names.end(), "camera 0 focal length");
  ASSERT_NE(place, without.names.end());
  const auto f = place - without.names.begin();
  const double of_prior = 0.002 * focal * 0.002 * focal;
  const Eigen::VectorXd column = without.covariance.col(f);
  const Eigen::MatrixXd expected =
      without.covariance - column * column.transpose() / (of_prior + without.covariance(f, f));
  // Measured: 2e-10.
  EXPECT_LT((with.covariance - expected).norm(), 1e-7 * expected.norm());
  const double share = with.prior_covariance(f, f) / with.covariance(f, f);
  EXPECT_NEAR(share, without.covariance(f, f) / (of_prior + without.covariance(f, f)), 1e-6);
  EXPECT_GT(share, 0.01);
  EXPECT_LT(share, 0.99);
}

// Data that poses chose for themselves count as if they were fewer, against a prior, too.
TEST(JointPriors, ChosenDataTellLess) {
  Scan scan = MakeScan(1, 0);
  JointOptions options = Shared();
  options.loss = JointLoss::kSquared;
  constexpr double kSigmaPx = 0.4;
  constexpr double kChosen = 6;
  options.loss_scale_px = LossScalePx(kSigmaPx);
  const Observability all = AnalyzeObservability(scan.problem, options, true, kSigmaPx);
  scan.problem.priors.chosen_variance = kChosen;
  const Observability chosen = AnalyzeObservability(scan.problem, options, true, kSigmaPx);
  EXPECT_LT((chosen.covariance - kChosen * all.covariance).norm(), 1e-9 * chosen.covariance.norm());
  const std::pair<const Eigen::MatrixXd&, const Eigen::MatrixXd&> by_scores[] = {
      {all.robust_covariance, chosen.robust_covariance},
      {all.regional_covariance, chosen.regional_covariance},
      {all.ring_covariance, chosen.ring_covariance}};
  for (const auto& [before, after] : by_scores) {
    ASSERT_GT(before.norm(), 0);
    EXPECT_LT((after - kChosen * before).norm(), 1e-9 * after.norm());
  }
  const double focal = scan.problem.cameras[0].params[0];
  LensPrior lens;
  lens.focal = {{focal, 0.002}, {}};
  scan.problem.priors.lenses = {lens};
  const Observability with = AnalyzeObservability(scan.problem, options, true, kSigmaPx);
  const auto f = std::find(all.names.begin(), all.names.end(), "camera 0 focal length") - all.names.begin();
  const double of_data = kChosen * all.covariance(f, f);
  const double of_prior = 0.002 * focal * 0.002 * focal;
  EXPECT_NEAR(with.prior_covariance(f, f) / with.covariance(f, f), of_data / (of_prior + of_data), 1e-6);
}

// Where the data leave a focal length open, the prior tells it, and says so.
TEST(JointPriors, WhatThePhotosDoNotTellIsThePriors) {
  Scan scan = MakeScan(2, 0, 0.4, 2);
  const double focal = scan.problem.cameras[0].params[0];
  LensPrior lens;
  lens.focal = {{focal, 0.05}, {}};
  lens.distortion = 0;
  scan.problem.priors.lenses = {lens};
  Reporter reporter;
  const JointReport report = AdjustJointly(Shared(), reporter, &scan.problem);
  ASSERT_EQ(report.focal_prior_share.size(), 1U);
  EXPECT_GT(report.focal_prior_share[0], 0.5);
  EXPECT_LT(report.focal_sigma_px[0], 0.06 * focal);
  EXPECT_LT(std::abs(scan.problem.cameras[0].params[0] - focal), 0.1 * focal);
}

// A photo's EXIF may be from before it was cut: what it says 2.5 times too short is as if it said nothing.
TEST(JointPriors, AFocalLengthThatIsStatedWronglyDrawsNothing) {
  std::vector<double> focal_px;
  std::vector<double> sigma_px;
  for (const bool is_stated : {false, true}) {
    Scan scan = MakeScan(2, 0, 0.4, 2);
    Camera given = scan.problem.cameras[0];
    given.params[0] /= 2.5;
    LensPrior lens;
    lens.focal = FocalPriorOf(given, is_stated);
    lens.distortion = 0;
    scan.problem.priors.lenses = {lens};
    Reporter reporter;
    const JointReport report = AdjustJointly(Shared(), reporter, &scan.problem);
    focal_px.push_back(scan.problem.cameras[0].params[0]);
    sigma_px.push_back(report.focal_sigma_px[0]);
  }
  EXPECT_EQ(focal_px[0], focal_px[1]);
  EXPECT_EQ(sigma_px[0], sigma_px[1]);
}

// Two stations before one background, each with points of the object of its own: how much farther the table
// had turned at the second one is told by the prior alone.
TEST(JointPriors, StationsAreTurnedAsThePriorSaysWherePhotosDoNot) {
  SyntheticTurntableOptions options;
  options.seed = 5;
  options.stations = 2;
  options.steps = 8;
  options.step_deg = 45;
  options.num_object_points = 160;
  options.num_background_points = 150;
  options.camera_model = CameraModelId::kSimpleRadial;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  AlignedScene aligned = SyntheticAlignedObject(turntable);
  aligned.background = SyntheticStaticModel(turntable);
  JointProblem problem = MakeJointProblem(aligned);
  constexpr double kTurnDeg = 3;
  StationTurnPrior prior;
  prior.sigma_rad = 0.1 * kDegree;
  for (size_t i = 0; i < problem.images.size(); ++i) {
    const bool is_second = problem.images[i].pose != problem.images[0].pose;
    // Whole turns do not matter.
    const double angle = problem.images[i].angle_rad + 2 * kPi * static_cast<double>(i % 3);
    (is_second ? prior.second : prior.first)
        .push_back({static_cast<int>(i), angle + (is_second ? kTurnDeg * kDegree : 0)});
  }
  std::vector<JointObservation>& seen = problem.object.observations;
  seen.erase(std::remove_if(seen.begin(), seen.end(),
                            [&](const JointObservation& o) {
                              return (problem.images[o.image].pose != problem.images[0].pose) !=
                                     (o.point % 2 == 1);
                            }),
             seen.end());
  const auto mean_turn = [&](const JointProblem& at) {
    double sum = 0;
    for (const StationTurnPrior::Place& place : prior.second) sum += at.images[place.image].angle_rad;
    for (const StationTurnPrior::Place& place : prior.first) sum -= at.images[place.image].angle_rad;
    return sum / static_cast<double>(prior.first.size()) / kDegree;
  };
  const double before = mean_turn(problem);
  problem.priors.station_turns = {prior};
  Reporter reporter;
  AdjustJointly(Shared(), reporter, &problem);
  EXPECT_NEAR(mean_turn(problem) - before, kTurnDeg, 0.01);
}

struct Errors {
  double squares = 0;
  int within = 0;
  int all = 0;
};

void AddErrors(const Scan& scan, const JointReport& report, Errors* errors) {
  for (size_t i = 0; i < scan.truth_rad.size(); ++i) {
    if (!(report.angle_sigma_deg[i] > 0)) continue;
    const double error = WrapAngle(scan.problem.images[i].angle_rad - scan.truth_rad[i]) / kDegree;
    errors->squares += error * error;
    errors->within += std::abs(error) <= 2 * report.angle_sigma_deg[i] ? 1 : 0;
    ++errors->all;
  }
}

// Equal steps: errors shrink, and the truth stays within the standard deviations.
TEST(EqualSteps, HelpsWhereStepsAreEqual) {
  Errors before;
  Errors after;
  for (uint64_t seed = 10; seed < 22; ++seed) {
    Scan scan = MakeScan(seed, 0);
    Reporter reporter;
    JointReport report = AdjustJointly(Shared(), reporter, &scan.problem);
    AddErrors(scan, report, &before);
    scan.problem.priors.turns = FindEqualSteps(scan.problem, scan.places, report);
    ASSERT_EQ(scan.problem.priors.turns.size(), 1U);
    EXPECT_TRUE(scan.problem.priors.turns[0].closes);
    EXPECT_GT(scan.problem.priors.turns[0].sigma_rad, 0);
    scan.problem.priors.data_inflation = DataInflation(scan.problem, report);
    report = AdjustJointly(Shared(), reporter, &scan.problem);
    AddErrors(scan, report, &after);
    EXPECT_GT(AnglePriorShare(report).value_or(0), 0.05);
  }
  RecordProperty("before", std::to_string(std::sqrt(before.squares / before.all)));
  RecordProperty("after", std::to_string(std::sqrt(after.squares / after.all)));
  EXPECT_LT(after.squares, 0.8 * before.squares);
  EXPECT_GE(after.within, 0.9 * after.all);
}

// Unequal ones: the prior is so wide that it moves nothing.
TEST(EqualSteps, MovesNothingWhereStepsAreUnequal) {
  for (uint64_t seed = 30; seed < 33; ++seed) {
    Scan scan = MakeScan(seed, 0.5);
    Reporter reporter;
    JointReport report = AdjustJointly(Shared(), reporter, &scan.problem);
    const Scan alone = scan;
    scan.problem.priors.turns = FindEqualSteps(scan.problem, scan.places, report);
    report = AdjustJointly(Shared(), reporter, &scan.problem);
    for (size_t i = 0; i < scan.truth_rad.size(); ++i) {
      const double moved =
          std::abs(WrapAngle(scan.problem.images[i].angle_rad - alone.problem.images[i].angle_rad)) / kDegree;
      EXPECT_LE(moved, 0.05 * report.angle_sigma_deg[i] + 1e-9);
    }
    EXPECT_LT(AnglePriorShare(report).value_or(0), 0.02);
  }
}

// A turn of 220 degrees in twelve photos is no whole one.
TEST(EqualSteps, PartialTurnsStayPartial) {
  Scan scan = MakeScan(40, 0, 0.4, 12);
  Reporter reporter;
  const JointReport report = AdjustJointly(Shared(), reporter, &scan.problem);
  const std::vector<EqualStepsPrior> turns = FindEqualSteps(scan.problem, scan.places, report);
  ASSERT_EQ(turns.size(), 1U);
  EXPECT_FALSE(turns[0].closes);
  EXPECT_NEAR(std::abs(turns[0].step_rad), 20 * kDegree, 0.1 * kDegree);
}

// Photos whose names are in another order than they were taken: the same steps as those of the right order,
// in either direction.
TEST(EqualSteps, DoNotDependOnNames) {
  for (const int num : {12, 18}) {
    Scan scan = MakeScan(41, 0, 0.4, num);
    Reporter reporter;
    const JointReport report = AdjustJointly(Shared(), reporter, &scan.problem);
    const std::vector<EqualStepsPrior> turns = FindEqualSteps(scan.problem, scan.places, report);
    std::vector<CapturePlace> shuffled = scan.places;
    std::mt19937 random(5);
    for (size_t i = shuffled.size(); i > 1; --i)
      std::swap(shuffled[i - 1].place, shuffled[random() % i].place);
    const std::vector<EqualStepsPrior> again = FindEqualSteps(scan.problem, shuffled, report);
    ASSERT_EQ(turns.size(), 1U);
    ASSERT_EQ(again.size(), 1U);
    EXPECT_EQ(again[0].closes, turns[0].closes);
    EXPECT_NEAR(std::abs(again[0].step_rad), std::abs(turns[0].step_rad), 1e-9);
    // Widths are tried in steps of 5 %.
    EXPECT_NEAR(again[0].sigma_rad, turns[0].sigma_rad, 0.06 * turns[0].sigma_rad);
  }
}

// By the angles alone no two photos share a place: two that do are no steps.
TEST(EqualSteps, AreNoneWhereTwoPhotosShareAPlace) {
  Scan scan = MakeScan(42, 0);
  Reporter reporter;
  const JointReport report = AdjustJointly(Shared(), reporter, &scan.problem);
  // Names that say nothing, so that the angles' own order is asked.
  std::mt19937 random(5);
  for (size_t i = scan.places.size(); i > 1; --i)
    std::swap(scan.places[i - 1].place, scan.places[random() % i].place);
  EXPECT_EQ(FindEqualSteps(scan.problem, scan.places, report).size(), 1U);
  scan.problem.images[6].angle_rad = scan.problem.images[7].angle_rad + 1 * kDegree;
  EXPECT_TRUE(FindEqualSteps(scan.problem, scan.places, report).empty());
}

}  // namespace
}  // namespace s2gs
