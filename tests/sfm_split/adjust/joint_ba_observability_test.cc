#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <utility>

#include "sfm_split/adjust/joint_ba.h"
#include "sfm_split/joint_system/joint_system.h"
#include "tests/sfm_split/adjust/joint_scene.h"
#include "tests/support/measured_bound.h"

namespace s2gs {
namespace {

using Eigen::Vector3d;

TEST(JointBa, WithoutAGaugeTheNullityCountsItsFreedoms) {
  JointScene scene;
  scene.Build(9);
  JointOptions options;
  FilterObservations(options, 10, &scene.truth);
  // A similarity of the world, and the object's frame turned about the axis against the angles.
  const Observability free = AnalyzeObservability(scene.truth, options, false, 1);
  EXPECT_EQ(free.nullity, 8);
  EXPECT_GT(free.gap, 1e3) << free.eigenvalues.head(12).transpose();
  EXPECT_EQ(AnalyzeObservability(scene.truth, options, true, 1).nullity, 0);

  JointProblem free_object = scene.truth;
  for (size_t i = 0; i < free_object.images.size(); ++i) {
    free_object.images[i].world_from_object = scene.truth.WorldFromObject(static_cast<int>(i));
  }
  free_object.free_object = true;
  // A similarity of the world and another of the object's frame.
  EXPECT_EQ(AnalyzeObservability(free_object, options, false, 1).nullity, 14);
  EXPECT_EQ(AnalyzeObservability(free_object, options, true, 1).nullity, 0);
}

TEST(JointBa, WithoutABackgroundTheStationsTurnFreely) {
  JointScene scene;
  scene.background_points = 0;
  scene.Build(10);
  JointOptions options;
  // Two more stations, each free to turn with its images' angles.
  EXPECT_EQ(AnalyzeObservability(scene.truth, options, false, 1).nullity, 10);
  EXPECT_EQ(AnalyzeObservability(scene.truth, options, true, 1).nullity, 0);
  scene.Perturb(0.003, 1.01, 2);
  Reporter reporter;
  const JointReport report = AdjustJointly(ExactJointOptions(), reporter, &scene.start);
  EXPECT_EQ(report.model, JointModel::kSharedStations);
  EXPECT_LT(report.object_rms_px, 1e-8);
  EXPECT_EQ(report.scale_sigma_rel, std::numeric_limits<double>::infinity());
}

// Nor is a table's angle known from station to station where its object wobbles.
TEST(JointBa, WithoutABackgroundAnglesOfAWobblingObjectAreKnownInsideTheFirstStationAlone) {
  JointScene scene;
  scene.stations = 2;
  scene.background_points = 0;
  scene.noise_px = 0.3;
  scene.wobble_deg = 0.3;
  scene.Build(11);
  JointOptions options;
  options.model = JointModel::kFreeObject;
  Reporter reporter;
  const JointReport report = AdjustJointly(options, reporter, &scene.start);
  ASSERT_EQ(report.angle_sigma_deg.size(), scene.start.images.size());
  for (size_t i = 0; i < scene.start.images.size(); ++i) {
    EXPECT_EQ(std::isfinite(report.angle_sigma_deg[i]), scene.start.images[i].pose == 0)
        << scene.start.images[i].name;
  }
}

// Along directions that nothing tells covariances are zero, which is not how well they are known.
TEST(JointBa, NoKeypointsTellNoTurn) {
  for (const JointModel model : {JointModel::kSharedStations, JointModel::kFreeObject}) {
    for (const bool is_bare : {false, true}) {
      JointScene scene;
      scene.stations = 1;
      scene.background_points = 0;
      scene.noise_px = 0.3;
      scene.Build(12);
      const size_t bare = 5;
      if (is_bare) {
        for (JointObservation& observation : scene.start.object.observations) {
          if (observation.image == static_cast<int>(bare)) observation.active = false;
        }
      }
      JointOptions options;
      options.model = model;
      Reporter reporter;
      const JointReport report = AdjustJointly(options, reporter, &scene.start);
      ASSERT_EQ(report.turn_sigma_deg.size(), scene.start.images.size());
      for (size_t i = 0; i < scene.start.images.size(); ++i) {
        const bool is_told = !is_bare || i != bare;
        EXPECT_EQ(std::isfinite(report.turn_sigma_deg[i]), is_told) << scene.start.images[i].name;
        EXPECT_EQ(std::isfinite(report.angle_sigma_deg[i]), is_told) << scene.start.images[i].name;
      }
    }
  }
}

// A sum of parameters is untold where it moves along a null direction: without a background, how far the
// table turned between photos of two stations, but not between those of one.
TEST(JointBa, WhatMovesAlongNullDirectionsIsUntold) {
  JointScene scene;
  scene.stations = 2;
  scene.background_points = 0;
  scene.Build(13);
  JointOptions options;
  const JointSystem system(scene.truth, options, false);
  const Observability found = AnalyzeObservability(scene.truth, options, false, 1);
  ASSERT_GT(found.nullity, 0);
  const auto place_of = [&](int block, int value) {
    const auto at = std::find(found.parameters.begin(), found.parameters.end(), std::make_pair(block, value));
    return at - found.parameters.begin();
  };
  const int last = static_cast<int>(scene.truth.images.size()) - 1;
  const auto is_untold = [&](int image, int other) {
    Eigen::VectorXd turn = Eigen::VectorXd::Zero(found.num_parameters);
    turn(place_of(system.AngleBlock(image), 0)) = 1;
    turn(place_of(system.AngleBlock(other), 0)) = -1;
    return IsUntold(found, turn);
  };
  EXPECT_TRUE(is_untold(last, 0));
  EXPECT_FALSE(is_untold(last, last - 1));
  EXPECT_FALSE(is_untold(1, 0));
}

// What cannot be known is named: here the focal length, when the table stands still and all cameras are one.
TEST(JointBa, UnobservableDirectionsAreNamed) {
  JointScene scene;
  scene.stations = 2;
  scene.step_deg = 0;
  scene.background_points = 0;
  scene.Build(11);
  JointOptions options;
  options.min_triangulation_deg = 0;
  const Observability still = AnalyzeObservability(scene.truth, options, true, 1);
  EXPECT_GT(still.nullity, 0);
  bool axis_named = false;
  for (const std::string& direction : still.null_directions) {
    axis_named = axis_named || direction.find("axis") != std::string::npos;
  }
  EXPECT_TRUE(axis_named);
  Reporter reporter;
  scene.Perturb(0.002, 1, 1);
  const JointReport report = AdjustJointly(options, reporter, &scene.start);
  EXPECT_GT(report.observability.nullity, 0);
  EXPECT_TRUE(std::isinf(report.axis_direction_sigma_deg)) << report.axis_direction_sigma_deg;
  EXPECT_TRUE(std::isinf(report.axis_point_sigma)) << report.axis_point_sigma;
  EXPECT_TRUE(scene.start.axis.allFinite());
  ExpectWithin(numerics::kGeometry, "unobservable scene whose nullity is not reported", "double",
               still.nullity > 0 && report.observability.nullity > 0 ? 0 : 1, 0);
}

TEST(JointBa, ZeroBaselineLeavesTheScaleUnobservable) {
  JointScene scene;
  scene.stations = 3;
  scene.Build(12);
  // All stations at one place, with different views of the background.
  JointProblem& problem = scene.truth;
  const Vector3d centre = CameraCentre(problem.cam_from_world[0]);
  for (int s = 1; s < 3; ++s) {
    Rigid3& pose = problem.cam_from_world[s];
    pose.rotation = Eigen::Quaterniond(Eigen::AngleAxisd(0.05 * s, Vector3d(1, s, 0).normalized())) *
                    problem.cam_from_world[0].rotation;
    pose.translation = -(pose.rotation * centre);
  }
  for (JointBody* body : {&problem.object, &problem.background}) {
    for (JointObservation& observation : body->observations) {
      Vector3d x = body->points[observation.point];
      if (body == &problem.object) x = problem.WorldFromObject(observation.image) * x;
      observation.xy = *ProjectToImage(problem.cameras[0],
                                       problem.cam_from_world[problem.images[observation.image].pose] * x);
    }
  }
  scene.start = problem;
  Reporter reporter;
  const JointReport report = AdjustJointly(ExactJointOptions(), reporter, &scene.start);
  EXPECT_EQ(report.background_observations, 0);  // points without depth
  EXPECT_EQ(report.scale_sigma_rel, std::numeric_limits<double>::infinity());
  EXPECT_TRUE(scene.start.axis.allFinite());
  ExpectWithin(numerics::kGeometry, "zero baseline: residual that is left [px]", "double",
               scene.start.axis.allFinite() ? report.object_rms_px : NAN, 1e-6);
}

}  // namespace
}  // namespace s2gs
