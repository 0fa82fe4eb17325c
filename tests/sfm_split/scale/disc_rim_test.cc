#include "sfm_split/scale/disc_rim.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <random>

#include "sfm_split/base/angles.h"
#include "tests/support/camera_towards_origin.h"

namespace s2gs {
namespace {

constexpr double kRadius = 0.4;
constexpr double kHeight = 0.05;

// A table whose axis leans, and a camera that looks at it.
struct Scene {
  Camera camera{1, CameraModelId::kSimpleRadial, 1280, 960, {1000, 640, 480, -0.05}};
  Rigid3 world_from_table;  // z is the axis
  TurntableAxis axis;

  Scene() {
    world_from_table.rotation = Eigen::AngleAxisd(0.7, Eigen::Vector3d(1, 2, -1).normalized());
    world_from_table.translation = {0.3, -1.2, 2};
    axis.direction = world_from_table.rotation * Eigen::Vector3d::UnitZ();
    axis.point = world_from_table * Eigen::Vector3d(0, 0, 0.3);
  }
  Rigid3 CamFromWorld(double azimuth, double elevation) const {
    const Eigen::Vector3d center(1.5 * std::cos(azimuth) * std::cos(elevation),
                                 1.5 * std::sin(azimuth) * std::cos(elevation), 1.5 * std::sin(elevation));
    return CameraTowardsOrigin(center) * world_from_table.Inverse();
  }
  RimSighting See(const Rigid3& cam_from_world, double angle) const {
    const Eigen::Vector3d place(kRadius * std::cos(angle), kRadius * std::sin(angle), kHeight);
    return {&camera, cam_from_world,
            ProjectToImage(camera, cam_from_world * (world_from_table * place)).value()};
  }
};

TEST(DiscRim, TwoPlacesOfOnePhotoAreEnough) {
  const Scene scene;
  const Rigid3 camera = scene.CamFromWorld(1, 0.5);
  const auto rim = FitDiscRim(scene.axis, {scene.See(camera, 1.1), scene.See(camera, 1.1 + kPi)}, 1);
  ASSERT_TRUE(rim.has_value());
  EXPECT_NEAR(rim->radius, kRadius, 1e-8);
  EXPECT_NEAR(rim->height, kHeight - 0.3, 1e-8);  // the axis' point lies at .3
  EXPECT_EQ(rim->rms_px, 0);
  EXPECT_LT(rim->sigma, 0.01 * kRadius);
}

TEST(DiscRim, ItsSigmaIsTheErrorThatItHas) {
  const Scene scene;
  std::mt19937 random(1);
  std::normal_distribution<double> noise(0, 1);
  double squares = 0;
  double sigma = 0;
  constexpr int kTrials = 300;
  for (int i = 0; i < kTrials; ++i) {
    std::vector<RimSighting> sightings;
    for (int k = 0; k < 8; ++k) {
      sightings.push_back(scene.See(scene.CamFromWorld(k % 2, 0.4 + 0.3 * (k % 2)), 0.8 * k));
      sightings.back().xy += Eigen::Vector2d(noise(random), noise(random));
    }
    const auto rim = FitDiscRim(scene.axis, sightings, 1);
    ASSERT_TRUE(rim.has_value());
    squares += std::pow((rim->radius - kRadius) / rim->sigma, 2);
    sigma += rim->sigma / kTrials;
  }
  // Over 300 trials the mean square of a normal variable is 1 +- .08; the larger of noise and residuals
  // counts, which makes sigma 8 % too large on average.
  EXPECT_NEAR(squares / kTrials, 0.88, 0.24);
  EXPECT_LT(sigma, 0.002 * kRadius);
}

TEST(DiscRim, PlacesThatDoNotTellAreRefused) {
  const Scene scene;
  const Rigid3 camera = scene.CamFromWorld(0, 0.3);
  EXPECT_FALSE(FitDiscRim(scene.axis, {scene.See(camera, 0)}, 1).has_value());
  // Side by side on the near side: a higher disc that is smaller looks the same.
  EXPECT_FALSE(
      FitDiscRim(scene.axis, {scene.See(camera, 0), scene.See(camera, 0.02), scene.See(camera, -0.02)}, 1)
          .has_value());
  // A place that is not on the rim shows.
  std::vector<RimSighting> sightings;
  for (int k = 0; k < 6; ++k) sightings.push_back(scene.See(camera, k));
  sightings[2].xy += Eigen::Vector2d(40, 40);
  const auto rim = FitDiscRim(scene.axis, sightings, 1);
  EXPECT_TRUE(!rim.has_value() || rim->rms_px > 5);
}

}  // namespace
}  // namespace s2gs
