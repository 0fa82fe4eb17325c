#include "sfm_split/adjust/joint_ba.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "sfm_split/base/angles.h"
#include "tests/sfm_split/adjust/joint_scene.h"
#include "tests/support/measured_bound.h"

namespace s2gs {
namespace {

TEST(JointBa, ExactObservationsGiveTheExactScene) {
  double worst = 0;
  for (int stations = 2; stations <= 4; ++stations) {
    for (const CameraModelId model : {CameraModelId::kSimpleRadial, CameraModelId::kPinhole}) {
      JointScene scene;
      scene.stations = stations;
      scene.model = model;
      scene.Build(static_cast<uint32_t>(stations));
      scene.Perturb(0.005, 1.02, 1);
      Reporter reporter;
      const JointReport report = AdjustJointly(ExactJointOptions(), reporter, &scene.start);
      worst = std::max(worst, LargestDifference(scene.start, scene.truth));
      EXPECT_EQ(report.model, JointModel::kSharedStations);
      EXPECT_LT(report.object_rms_px, 1e-8);
      EXPECT_EQ(report.removed_observations, 0);
      EXPECT_EQ(report.observability.nullity, 0);
    }
  }
  ExpectWithin(numerics::kGeometry, "joint adjustment of exact observations, largest error of a parameter",
               "double", worst, 1e-9);
}

TEST(JointBa, OneStationIsAdjustedWithoutABackground) {
  JointScene scene;
  scene.stations = 1;
  scene.steps = 36;
  scene.step_deg = 10;
  scene.background_points = 0;
  scene.Build(5);
  scene.Perturb(0.003, 1.01, 2);
  Reporter reporter;
  const JointReport report = AdjustJointly(ExactJointOptions(), reporter, &scene.start);
  EXPECT_LT(LargestDifference(scene.start, scene.truth), 1e-9);
  EXPECT_EQ(report.observability.nullity, 0);
  EXPECT_EQ(report.scale_sigma_rel, std::numeric_limits<double>::infinity());
}

// A background that only one station sees has no depth: its points go, the rest is adjusted.
TEST(JointBa, BackgroundOfOneStationIsTakenOut) {
  JointScene scene;
  scene.stations = 1;
  scene.steps = 20;
  scene.step_deg = 18;
  scene.Build(6);
  scene.Perturb(0.003, 1.0, 3);
  Reporter reporter;
  const JointReport report = AdjustJointly(ExactJointOptions(), reporter, &scene.start);
  EXPECT_EQ(report.background_observations, 0);
  EXPECT_GT(report.undetermined_points, 50);
  EXPECT_LT(LargestDifference(scene.start, scene.truth), 1e-9);
}

TEST(JointBa, OutliersAreTakenOutAndDoNoHarm) {
  JointScene scene;
  scene.noise_px = 0.3;
  scene.outliers = 0.15;
  scene.Build(7);
  scene.Perturb(0.005, 1.02, 4);
  Reporter reporter;
  JointOptions options;
  options.num_threads = 2;
  const JointReport report = AdjustJointly(options, reporter, &scene.start);
  EXPECT_EQ(report.model, JointModel::kSharedStations);
  EXPECT_NEAR(report.sigma_px, 0.3, 0.03);
  const size_t all = scene.truth.object.observations.size() + scene.truth.background.observations.size();
  EXPECT_NEAR(report.removed_observations / static_cast<double>(all), 0.15, 0.02);
  EXPECT_LT(LargestDifference(scene.start, scene.truth), 0.01);
  for (size_t i = 0; i < scene.start.images.size(); ++i) {
    EXPECT_LT(std::abs(WrapAngle(scene.start.images[i].angle_rad - scene.truth.images[i].angle_rad)),
              5 * report.angle_sigma_deg[i] * kDegree + 1e-15);
  }
}

TEST(JointBa, FocalLengthsFromWideToTele) {
  double worst = 0;
  for (const double over_width : {0.3, 0.5, 1.0, 3.0, 10.0}) {
    JointScene scene;
    scene.focal = over_width * 640;
    scene.model = CameraModelId::kSimplePinhole;
    scene.stations = 3;
    scene.Build(13);
    scene.Perturb(0.002 / over_width, 1.01, 1);
    Reporter reporter;
    JointOptions options = ExactJointOptions();
    options.max_iterations = 200;
    const JointReport report = AdjustJointly(options, reporter, &scene.start);
    EXPECT_TRUE(report.observability.computed);
    EXPECT_LT(report.object_rms_px, 1e-6) << over_width;
    // A long lens tells less: at 10 x width the observations' rounding alone moves a station by 1e-8.
    const double predicted = std::sqrt(report.observability.covariance.diagonal().maxCoeff());
    EXPECT_LT(LargestDifference(scene.start, scene.truth), std::max(1e-9, 6 * predicted)) << over_width;
    EXPECT_LT(predicted, 1e-7);
    worst = std::max(worst, LargestDifference(scene.start, scene.truth) / std::max(1e-9, 6 * predicted));
  }
  ExpectWithin(numerics::kGeometry,
               "focal length .3 to 10 x width: error over 1e-9 or six predicted sigmas of the rounding",
               "double", worst, 1);
}

TEST(JointBa, ShakenCamerasAreFreedOnlyWhenTheDataDemandIt) {
  for (const double shake : {0.0, 0.002}) {
    JointScene scene;
    scene.noise_px = 0.4;
    scene.shake = shake;
    scene.Build(14);
    Reporter reporter;
    JointOptions options;
    options.num_threads = 2;
    const JointReport report = AdjustJointly(options, reporter, &scene.start);
    EXPECT_EQ(report.model, shake > 0 ? JointModel::kFreeCameras : JointModel::kSharedStations);
    ASSERT_EQ(report.tests.size(), 2u);
    EXPECT_EQ(report.tests[0].accepted, shake > 0);
    EXPECT_FALSE(report.tests[1].accepted);
    if (shake > 0) {
      EXPECT_GT(report.tests[0].f_statistic, 10);
    } else {
      EXPECT_NEAR(report.tests[0].score, 1, 0.3);
      EXPECT_FALSE(report.tests[0].fitted);
    }
    EXPECT_NEAR(report.sigma_px, 0.4, 0.04);
  }
}

// Weights discount what a station's photos repeat. Within one photo every point is seen once, with an error
// of its own: were the score's gradient weighted too, weights of 1 and .1 by turns would make of its mean of
// 1 the ratio mean(w^2) / mean(w)^2 = 1.67.
TEST(JointBa, ScoresDoNotDependOnHowMuchObservationsCount) {
  JointScene scene;
  scene.noise_px = 0.4;
  scene.Build(14);
  for (JointObservation& observation : scene.start.background.observations) {
    observation.weight = observation.point % 2 == 0 ? 1 : 0.1;
  }
  Reporter reporter;
  JointOptions options;
  options.num_threads = 2;
  const JointReport report = AdjustJointly(options, reporter, &scene.start);
  ASSERT_FALSE(report.tests.empty());
  EXPECT_FALSE(report.tests[0].accepted);
  EXPECT_NEAR(report.tests[0].score, 1, 0.3);
}

TEST(JointBa, AWobblingTableFreesTheObjectNotTheCameras) {
  JointScene scene;
  scene.noise_px = 0.4;
  scene.wobble_deg = 0.3;
  scene.Build(15);
  Reporter reporter;
  JointOptions options;
  options.num_threads = 2;
  const JointReport report = AdjustJointly(options, reporter, &scene.start);
  EXPECT_EQ(report.model, JointModel::kFreeObject);
  EXPECT_FALSE(report.tests[0].accepted);
  EXPECT_TRUE(report.tests[1].accepted);
  EXPECT_NEAR(report.sigma_px, 0.4, 0.04);
  EXPECT_EQ(scene.start.cam_from_world.size(), 3u);
}

TEST(JointBa, InterruptionThrowsAndLeavesTheProblemAsItWas) {
  class Stopping : public Reporter {
   public:
    void Progress(std::string_view, int64_t done, int64_t) override { stop_ = done >= 1; }
    bool StopRequested() const override { return stop_; }

   private:
    bool stop_ = false;
  };
  JointScene scene;
  scene.Build(16);
  scene.Perturb(0.005, 1.02, 1);
  const JointProblem before = scene.start;
  Stopping reporter;
  EXPECT_THROW(AdjustJointly(JointOptions(), reporter, &scene.start), Interrupted);
  EXPECT_EQ(LargestDifference(before, scene.start), 0);
}

TEST(JointBa, NothingToAdjustIsNoFault) {
  JointProblem empty;
  Reporter reporter;
  EXPECT_EQ(AdjustJointly(JointOptions(), reporter, &empty).object_observations, 0);
  JointScene scene;
  scene.object_points = 0;
  scene.background_points = 0;
  scene.Build(17);
  EXPECT_EQ(AdjustJointly(JointOptions(), reporter, &scene.start).object_observations, 0);
}

TEST(JointBa, OptionsAreChecked) {
  JointOptions options;
  EXPECT_FALSE(options.Check());
  options.loss_scale_px = -1;
  EXPECT_EQ(options.Check()->field, "loss_scale_px");
}

}  // namespace
}  // namespace s2gs
