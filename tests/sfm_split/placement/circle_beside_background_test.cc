#include "sfm_split/placement/circle_beside_background.h"

#include <gtest/gtest.h>

#include <map>
#include <string>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "tests/support/synthetic_models.h"
#include "tests/support/synthetic_turntable.h"

namespace s2gs {
namespace {

using Eigen::Vector3d;

constexpr double kExact = 1e-9;  // of lengths of about 1, in double precision

SyntheticTurntableOptions ThreeStations() {
  SyntheticTurntableOptions options;
  options.stations = 3;
  options.steps = 4;
  options.num_object_points = 50;
  options.num_background_points = 100;
  options.pixel_noise = 0;
  return options;
}

Rigid3 About(double angle_rad) {
  return {Eigen::Quaterniond(RotationAbout<double>(Vector3d::UnitZ(), angle_rad)), Vector3d::Zero()};
}

// As circular motion leaves it: each station's first photo has the angle 0, which turns its camera instead.
AlignedScene ByCircle(const SyntheticTurntable& turntable) {
  AlignedScene aligned;
  aligned.scene = turntable.scene;
  std::map<int, double> first;
  for (View& view : aligned.scene.views) {
    const double turn = first.try_emplace(view.station, view.angle_deg * kDegree).first->second;
    view.cam_from_world = view.cam_from_world * About(turn);
    view.world_from_object = About(-turn) * view.world_from_object;
    view.angle_deg = WrapAngle(view.angle_deg * kDegree - turn) / kDegree;
  }
  return aligned;
}

// A frame of its own, as SfM has it.
Sim3 Elsewhere() {
  Sim3 there;
  there.scale = 2.5;
  there.rotation = Eigen::Quaterniond(0.4, -0.3, 0.8, 0.2).normalized();
  there.translation = {3, -2, 7};
  return there;
}

double Apart(const Rigid3& a, const Rigid3& b) { return (a.Matrix() - b.Matrix()).cwiseAbs().maxCoeff(); }

TEST(CircleBesideBackground, TurnsStationsToWhereTheBackgroundHasThem) {
  const SyntheticTurntable turntable = MakeSyntheticTurntable(ThreeStations());
  AlignedScene aligned = ByCircle(turntable);
  std::map<std::string, Rigid3> cam_from_object;
  for (const View& view : aligned.scene.views) cam_from_object[view.name] = view.CamFromObject();
  const ColmapModel truth = SyntheticStaticModel(turntable);
  ASSERT_TRUE(PutBackgroundBeside(SyntheticStaticModel(turntable, Elsewhere()), &aligned));
  // The world is the truth's but for a turn about the axis, which the first photo has.
  const View& first = aligned.scene.views[0];
  const Rigid3 turned = turntable.scene.views[0].cam_from_world.Inverse() * first.cam_from_world;
  EXPECT_LT(turned.translation.norm(), kExact);
  ASSERT_EQ(aligned.scene.views.size(), turntable.scene.views.size());
  for (size_t v = 0; v < aligned.scene.views.size(); ++v) {
    const View& view = aligned.scene.views[v];
    EXPECT_LT(Apart(view.cam_from_world, turntable.scene.views[v].cam_from_world * turned), kExact);
    EXPECT_LT(Apart(view.CamFromObject(), cam_from_object[view.name]), kExact);
    EXPECT_LT(Apart(view.world_from_object, About(view.angle_deg * kDegree)), kExact);
  }
  ASSERT_EQ(aligned.background.points3D.size(), truth.points3D.size());
  for (const auto& [id, point] : aligned.background.points3D)
    EXPECT_LT((turned * point.xyz - truth.points3D.at(id).xyz).norm(), 1e3 * kExact);
}

TEST(CircleBesideBackground, AModelThatContradictsTheSceneIsRefused) {
  const SyntheticTurntable turntable = MakeSyntheticTurntable(ThreeStations());
  ColmapModel background = SyntheticStaticModel(turntable, Elsewhere());
  const int odd = turntable.scene.views.back().station;
  const auto station_of = [&](const std::string& name) {
    for (const View& view : turntable.scene.views)
      if (view.name == name) return view.station;
    return -1;
  };
  for (auto& [id, image] : background.images) {
    if (station_of(image.name) != odd) continue;
    // As if the table had been tilted before this station's photos.
    const Rigid3 tilt{Eigen::Quaterniond(Eigen::AngleAxisd(0.3, Vector3d::UnitX())), Vector3d::Zero()};
    image.cam_from_world = tilt * image.cam_from_world;
  }
  AlignedScene aligned = ByCircle(turntable);
  const Rigid3 before = aligned.scene.views.back().cam_from_world;
  EXPECT_FALSE(PutBackgroundBeside(background, &aligned));
  EXPECT_TRUE(aligned.background.images.empty());
  EXPECT_EQ(Apart(aligned.scene.views.back().cam_from_world, before), 0);
}

TEST(CircleBesideBackground, OneStationOfItSaysNothing) {
  const SyntheticTurntable turntable = MakeSyntheticTurntable(ThreeStations());
  ColmapModel background = SyntheticStaticModel(turntable, Elsewhere());
  std::vector<std::string> others;
  for (const View& view : turntable.scene.views)
    if (view.station != 0) others.push_back(view.name);
  RemoveImages(others, &background);
  AlignedScene aligned = ByCircle(turntable);
  EXPECT_TRUE(PutBackgroundBeside(background, &aligned));
  EXPECT_TRUE(aligned.background.images.empty());
}

}  // namespace
}  // namespace s2gs
