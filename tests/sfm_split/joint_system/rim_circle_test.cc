#include "sfm_split/joint_system/rim_circle.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "sfm_split/adjust/joint_ba.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/joint_system/joint_system.h"
#include "tests/support/synthetic_aligned_object.h"
#include "tests/support/synthetic_turntable.h"

namespace s2gs {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::Vector4d;

// A camera that looks down at an axis that leans a little.
struct View {
  Camera camera{1, CameraModelId::kSimpleRadial, 640, 480, {600, 320, 240, -0.1}};
  Rigid3 cam_from_world;
  Vector4d axis{0.03, -0.02, 0.1, -0.05};
  RimCircle circle{-0.2, 0.9};

  View() {
    cam_from_world.rotation = Eigen::AngleAxisd(-115 * kDegree, Vector3d::UnitX()) *
                              Eigen::AngleAxisd(20 * kDegree, Vector3d::UnitZ());
    cam_from_world.translation = {0.1, -0.2, 4};
  }

  Vector2d Place(double phi) const {
    const Vector3d along = Vector3d(axis(0), axis(1), 1).normalized();
    const Vector3d across = along.unitOrthogonal();
    const Vector3d x = Vector3d(axis(2), axis(3), 0) + circle.height * along +
                       circle.radius * (std::cos(phi) * across + std::sin(phi) * along.cross(across));
    return *ProjectToImage(camera, cam_from_world * x);
  }
};

TEST(RimCircle, OfPlacesOnItsPicture) {
  const View view;
  std::vector<Vector2d> places;
  for (int k = 0; k < 20; ++k) places.push_back(view.Place(0.3 * k));
  const auto circle = NearestRimCircle(view.camera, view.cam_from_world, view.axis, places);
  ASSERT_TRUE(circle.has_value());
  EXPECT_NEAR(circle->height, view.circle.height, 1e-8);
  EXPECT_NEAR(circle->radius, view.circle.radius, 1e-8);
  for (const Vector2d& place : places)
    EXPECT_NEAR(OffsetFromRim(view.camera, view.cam_from_world, view.axis, *circle, place)->px, 0, 1e-6);
}

// Edges err; from as near to the camera as one likes all places are about as far from the axis.
TEST(RimCircle, OfPlacesThatErr) {
  const View view;
  std::vector<Vector2d> places;
  for (int k = 0; k < 60; ++k)
    places.push_back(view.Place(0.1 * k) + 0.5 * Vector2d(std::sin(7.0 * k), std::cos(11.0 * k)));
  const auto circle = NearestRimCircle(view.camera, view.cam_from_world, view.axis, places);
  ASSERT_TRUE(circle.has_value());
  // Half a pixel of the radius' 140 in one place; a tenth of that of all.
  EXPECT_NEAR(circle->height, view.circle.height, 2e-3);
  EXPECT_NEAR(circle->radius, view.circle.radius, 2e-3);
}

TEST(RimCircle, IsFoundFromPlacesOfAPartOfIt) {
  const View view;
  std::vector<Vector2d> places;
  for (int k = 0; k < 20; ++k) places.push_back(view.Place(2 + 0.1 * k));
  const auto circle = NearestRimCircle(view.camera, view.cam_from_world, view.axis, places);
  ASSERT_TRUE(circle.has_value());
  EXPECT_NEAR(circle->height, view.circle.height, 1e-6);
  EXPECT_NEAR(circle->radius, view.circle.radius, 1e-6);
}

// By central differences of the offset itself, of a place that is not on it.
TEST(RimCircle, DerivativesAreThoseOfDifferences) {
  for (const double phi : {0.2, 1.9, 3.7, 5.0}) {
    View view;
    const Vector2d place = view.Place(phi) + Vector2d(0.8, -0.5);
    const auto offset = OffsetFromRim(view.camera, view.cam_from_world, view.axis, view.circle, place);
    ASSERT_TRUE(offset.has_value());
    EXPECT_LE(std::abs(offset->px), Vector2d(0.8, -0.5).norm());
    const auto px = [&](const View& moved) {
      return OffsetFromRim(moved.camera, moved.cam_from_world, moved.axis, moved.circle, place)->px;
    };
    constexpr double kDelta = 1e-5;
    const auto difference = [&](const auto& move) {
      View more = view;
      View less = view;
      move(kDelta, &more);
      move(-kDelta, &less);
      return (px(more) - px(less)) / (2 * kDelta);
    };
    // An offset of a pixel turns with the curve, whose radius is some 150 px: errors of second order are
    // below a hundredth of a derivative.
    const auto near = [](double a, double b) { EXPECT_NEAR(a, b, 0.01 * std::abs(b) + 0.05); };
    for (int k = 0; k < 3; ++k) {
      near(offset->by_pose(k), difference([&](double d, View* v) {
             const Vector3d centre = CameraCentre(v->cam_from_world);
             v->cam_from_world.rotation =
                 Eigen::Quaterniond(ExpRotation<double>(d * Vector3d::Unit(k))) * v->cam_from_world.rotation;
             v->cam_from_world.translation = -(v->cam_from_world.rotation * centre);
           }));
      near(offset->by_pose(3 + k), difference([&](double d, View* v) {
             const Vector3d centre = CameraCentre(v->cam_from_world) + d * Vector3d::Unit(k);
             v->cam_from_world.translation = -(v->cam_from_world.rotation * centre);
           }));
    }
    for (int k = 0; k < 4; ++k)
      near(offset->by_axis(k), difference([&](double d, View* v) { v->axis(k) += d; }));
    near(offset->by_circle(0), difference([&](double d, View* v) { v->circle.height += d; }));
    near(offset->by_circle(1), difference([&](double d, View* v) { v->circle.radius += d; }));
    for (int k = 0; k < 4; ++k)
      near(offset->by_camera(k),
           difference([&](double d, View* v) { v->camera.params[static_cast<size_t>(k)] += d; }));
  }
}

// Few points with large errors, and the rim of a table as it is.
struct Scan {
  JointProblem problem;
  Vector3d true_axis;
  int pose = 0;
};

Scan FewPointsOnATable() {
  SyntheticTurntableOptions options;
  options.seed = 5;
  options.stations = 1;
  options.steps = 18;
  options.step_deg = 20;
  options.num_object_points = 40;
  options.num_platter_points = 0;
  options.num_background_points = 0;
  options.pixel_noise = 4;
  options.camera_model = CameraModelId::kSimpleRadial;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  const AlignedScene aligned = SyntheticAlignedObject(turntable);
  Scan scan;
  scan.problem = MakeJointProblem(aligned);
  scan.true_axis = scan.problem.AxisDirection();
  const RimCircle circle{-0.3, 0.8};
  RimPrior rim;
  rim.sigma_px = 0.5;
  const Vector3d along = scan.problem.AxisDirection();
  const Vector3d across = along.unitOrthogonal();
  const Camera& camera = scan.problem.cameras[static_cast<size_t>(scan.problem.images[0].camera)];
  for (int k = 0; k < 36; ++k) {
    const double phi = 10 * k * kDegree;
    const Vector3d x = scan.problem.AxisPoint() + circle.height * along +
                       circle.radius * (std::cos(phi) * across + std::sin(phi) * along.cross(across));
    const auto xy = ProjectToImage(camera, scan.problem.cam_from_world[0] * x);
    if (xy) rim.places.push_back(*xy);
  }
  scan.problem.priors.rims = {rim};
  return scan;
}

JointOptions Held() {
  JointOptions options;
  options.model = JointModel::kSharedStations;
  options.loss = JointLoss::kSquared;
  options.loss_scale_px = LossScalePx(2);
  options.refine_focal_length = options.refine_extra_params = false;
  return options;
}

double LeanDeg(const JointProblem& problem, const Vector3d& truth) {
  // In the camera, which the gauge holds.
  return std::acos(std::min(1.0, problem.AxisDirection().dot(truth))) / kDegree;
}

TEST(Rim, HoldsTheAxisThatFewPointsLetLean) {
  Scan with = FewPointsOnATable();
  ASSERT_GT(with.problem.priors.rims[0].places.size(), 30U);
  Scan without = with;
  without.problem.priors.rims.clear();
  Reporter reporter;
  AdjustJointly(Held(), reporter, &without.problem);
  AdjustJointly(Held(), reporter, &with.problem);
  const double lean = LeanDeg(without.problem, without.true_axis);
  EXPECT_GT(lean, 0.2);
  EXPECT_LT(LeanDeg(with.problem, with.true_axis), lean / 3);
}

// What the photos show is no share of what was known before.
TEST(Rim, NarrowsTheAxisAndIsNoPriorKnowledge) {
  Scan with = FewPointsOnATable();
  Scan without = with;
  without.problem.priors.rims.clear();
  const Observability a = AnalyzeObservability(with.problem, Held(), true, 2);
  const Observability b = AnalyzeObservability(without.problem, Held(), true, 2);
  // The worse of both.
  const auto axis = [](const Observability& of) {
    double variance = 0;
    for (size_t k = 0; k < of.names.size(); ++k) {
      if (of.names[k] == "axis direction") variance = std::max(variance, of.covariance(k, k));
    }
    return variance;
  };
  EXPECT_GT(axis(a), 0);
  EXPECT_LT(axis(a), axis(b) / 4);
  EXPECT_EQ(a.prior_covariance.norm(), 0);
}

}  // namespace
}  // namespace s2gs
