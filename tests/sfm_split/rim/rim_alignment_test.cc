#include "sfm_split/rim/rim_alignment.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <vector>

#include "sfm_split/base/angles.h"
#include "tests/support/synthetic_scan.h"
#include "tests/support/synthetic_turntable.h"

namespace s2gs {
namespace {

using Eigen::Vector3d;

// Both stations' cameras are turned by six degrees and put elsewhere; their photos show the rim as it is.
class RimAlignment : public testing::Test {
 protected:
  RimAlignment() {
    SyntheticTurntableOptions options;
    options.stations = 2;
    options.steps = 8;
    turntable_ = MakeSyntheticTurntable(options);
    features_ = SyntheticScanFeatures(turntable_);
    moved_ = turntable_.scene;
    for (int station = 0; station < 2; ++station) {
      RimPrior rim;
      rim.sigma_px = 0.5;
      for (size_t i = 0; i < features_.images.size() && rim.places.empty(); ++i) {
        if (features_.images[i].station != station) continue;
        rim.image = static_cast<int>(i);
        rim.places = PlacesSeenBy(features_.images[i].name);
      }
      rims_.push_back(rim);
    }
    for (View& view : moved_.views) {
      const Eigen::Quaterniond turn(
          Eigen::AngleAxisd(6 * kDegree, Vector3d(1, view.station == 0 ? 0.5 : -0.5, 0.3).normalized()));
      view.cam_from_world.rotation = turn * view.cam_from_world.rotation;
      view.cam_from_world.translation += Vector3d(0.1, -0.1, 0.2);
    }
  }

  const View& ViewNamed(const TurntableScene& scene, const std::string& name) const {
    return *std::find_if(scene.views.begin(), scene.views.end(),
                         [&](const View& view) { return view.name == name; });
  }

  std::vector<Eigen::Vector2d> PlacesSeenBy(const std::string& name) const {
    const View& view = ViewNamed(turntable_.scene, name);
    const Camera& camera = *turntable_.scene.FindCamera(view.camera_id);
    const TurntableAxis& axis = turntable_.scene.axis;
    const Vector3d across = axis.direction.unitOrthogonal();
    std::vector<Eigen::Vector2d> places;
    for (int k = 0; k < 48; ++k) {
      const double phi = 2 * kPi * k / 48;
      const Vector3d outwards = std::cos(phi) * across + std::sin(phi) * axis.direction.cross(across);
      const auto xy = ProjectToImage(
          camera, view.cam_from_world * Vector3d(axis.point - 0.4 * axis.direction + 1.1 * outwards));
      if (xy) places.push_back(*xy);
    }
    return places;
  }

  // Of the axis before a station's camera.
  double LeanDeg(const TurntableScene& scene, int station) const {
    const std::string& name = features_.images[static_cast<size_t>(rims_[station].image)].name;
    const Vector3d truth =
        ViewNamed(turntable_.scene, name).cam_from_world.rotation * turntable_.scene.axis.direction;
    const Vector3d found = ViewNamed(scene, name).cam_from_world.rotation * scene.axis.direction;
    return std::acos(std::min(1.0, truth.dot(found))) / kDegree;
  }

  SyntheticTurntable turntable_;
  ScanFeatures features_;
  TurntableScene moved_;
  std::vector<RimPrior> rims_;
};

TEST_F(RimAlignment, PutsTheAxisWhereTheRimShowsIt) {
  ASSERT_GT(rims_[0].places.size(), 30U);
  EXPECT_LT(RimErrorPx(rims_, features_, turntable_.scene), 1e-5);
  EXPECT_GT(RimErrorPx(rims_, features_, moved_), 1);
  TurntableScene scene = moved_;
  MoveToRims(rims_, features_, &scene);
  EXPECT_LT(RimErrorPx(rims_, features_, scene), 0.05);
  for (const int station : {0, 1}) {
    EXPECT_GT(LeanDeg(moved_, station), 3);
    EXPECT_LT(LeanDeg(scene, station), 0.1);
  }
}

TEST_F(RimAlignment, TrueCamerasStayWhereTheyAre) {
  TurntableScene scene = turntable_.scene;
  MoveToRims(rims_, features_, &scene);
  for (size_t v = 0; v < scene.views.size(); ++v) {
    EXPECT_NEAR(
        (scene.views[v].cam_from_world.translation - turntable_.scene.views[v].cam_from_world.translation)
            .norm(),
        0, 1e-4);
  }
}

}  // namespace
}  // namespace s2gs
