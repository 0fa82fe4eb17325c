#include "sfm_split/rim/rim_search.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/joint_system/rim_circle.h"
#include "tests/support/random_numbers.h"

namespace s2gs {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::Vector4d;

enum class Table { kRound, kSquare, kNone };

constexpr double kRadius = 0.9;
constexpr double kTop = -0.5;
constexpr int kPerPixel = 4;  // places of a pixel, along either side, that its grey is the mean of

struct Scene {
  Camera camera{1, CameraModelId::kSimpleRadial, 480, 360, {450, 240, 180, -0.05}};
  Rigid3 cam_from_world;
  RimView view;
  RimSearch search;
};

// What the scene's camera sees: of each pixel the mean of grey_at() over it, and noise of up to so many grey
// values.
template <typename GreyAt>
void Take(const GreyAt& grey_at, double noise, Scene* scene) {
  RandomNumbers random(8);
  GreyPicture& picture = scene->view.still;
  picture.photo_size = {480, 360};
  picture.width = 480;
  picture.height = 360;
  for (int y = 0; y < picture.height; ++y) {
    for (int x = 0; x < picture.width; ++x) {
      double sum = 0;
      for (int i = 0; i < kPerPixel * kPerPixel; ++i)
        sum += grey_at({x + (i % kPerPixel + 0.5) / kPerPixel, y + (i / kPerPixel + 0.5) / kPerPixel});
      picture.grey.push_back(
          static_cast<uint8_t>(sum / (kPerPixel * kPerPixel) + random.Uniform(-noise, noise)));
    }
  }
  scene->view.camera = scene->camera;
  scene->view.cam_from_world = scene->cam_from_world;
  scene->search.low = kTop;
  scene->search.high = kTop + 0.6;
  scene->search.radius = 0.4;
}

// A camera above a table before ground of coloured blocks, and a thing on the table that hides part of it.
Scene MakeScene(Table table) {
  Scene scene;
  scene.cam_from_world.rotation = Eigen::AngleAxisd(-120 * kDegree, Vector3d::UnitX());
  scene.cam_from_world.translation = {0, 0, 4};
  RandomNumbers random(7);
  std::vector<double> blocks(64 * 64);
  for (double& grey : blocks) grey = random.Uniform(0, 255);
  const auto grey_at = [&](const Vector2d& xy) -> double {
    // What stands on the table: a ball about the axis.
    const Vector3d centre = scene.cam_from_world * Vector3d(0, 0, kTop + 0.3);
    const Vector2d ball = *ProjectToImage(scene.camera, centre);
    if ((xy - ball).norm() < 0.3 / centre.z() * 450) return 90;
    const Vector3d ray = scene.cam_from_world.rotation.conjugate() * *UnprojectFromImage(scene.camera, xy);
    const Vector3d camera = CameraCentre(scene.cam_from_world);
    const Vector3d at = camera + (kTop - camera.z()) / ray.z() * ray;
    const bool on_table = table == Table::kRound    ? at.head<2>().norm() < kRadius
                          : table == Table::kSquare ? at.head<2>().cwiseAbs().maxCoeff() < kRadius
                                                    : false;
    if (on_table && ray.z() < 0) return 150;
    const auto column = static_cast<int>(std::floor(xy.x() / 15)) & 63;
    const auto row = static_cast<int>(std::floor(xy.y() / 15)) & 63;
    return blocks[static_cast<size_t>(64 * row + column)];
  };
  Take(grey_at, 0, &scene);
  return scene;
}

// A thick plate on ground of nearly its colour before a wall, seen from 11 degrees above, and the noise of a
// photo: the foot of the wall is the clearest edge, and as long as a circle seen from the side.
Scene MakePlainScene() {
  constexpr double kGround = kTop - 0.15;
  Scene scene;
  scene.cam_from_world.rotation = Eigen::AngleAxisd(-101 * kDegree, Vector3d::UnitX());
  scene.cam_from_world.translation = {0, 0, 4};
  const Vector3d camera = CameraCentre(scene.cam_from_world);
  const auto grey_at = [&](const Vector2d& xy) -> double {
    const Vector3d ray = scene.cam_from_world.rotation.conjugate() * *UnprojectFromImage(scene.camera, xy);
    const auto on_plane = [&](double z) -> Vector3d { return camera + (z - camera.z()) / ray.z() * ray; };
    if (ray.z() < 0 && on_plane(kTop).head<2>().norm() < kRadius) return 160;
    // The plate's side, where the ray first comes within the radius of the axis.
    const double along = ray.head<2>().squaredNorm();
    const double half = camera.head<2>().dot(ray.head<2>());
    const double root = half * half - along * (camera.head<2>().squaredNorm() - kRadius * kRadius);
    if (root > 0) {
      const Vector3d side = camera + (-half - std::sqrt(root)) / along * ray;
      if (side.z() < kTop && side.z() > kGround) return 110;
    }
    return ray.z() < 0 && on_plane(kGround).y() > -2.5 ? 172 : 90;
  };
  Take(grey_at, 2, &scene);
  return scene;
}

// How far places lie from the true rim [px], as the upper quartile has it.
double FarthestOff(const Scene& truth, const FoundRim& rim) {
  std::vector<double> off;
  for (const Vector2d& place : rim.places) {
    const auto offset =
        OffsetFromRim(truth.camera, truth.cam_from_world, Vector4d::Zero(), {kTop, kRadius}, place);
    off.push_back(std::abs(offset->px));
  }
  return Quantile(std::move(off), 0.75);
}

TEST(RimSearch, IsFoundToAPartOfAPixelByTruePoses) {
  const Scene scene = MakeScene(Table::kRound);
  const auto rim = FindRim(scene.view, scene.search);
  ASSERT_TRUE(rim.has_value());
  EXPECT_GT(rim->share, 0.8);
  EXPECT_LT(FarthestOff(scene, *rim), 0.3);
}

// The axis leans by eight degrees and the lens is a sixth too long: the rim is where the picture shows it.
TEST(RimSearch, IsFoundByPosesThatAreWrong) {
  const Scene truth = MakeScene(Table::kRound);
  Scene wrong = truth;
  wrong.search.axis.direction = Vector3d(std::sin(6 * kDegree), std::sin(-5 * kDegree), 1).normalized();
  wrong.view.camera.params[0] *= 7.0 / 6;
  const auto rim = FindRim(wrong.view, wrong.search);
  ASSERT_TRUE(rim.has_value());
  EXPECT_GT(rim->share, 0.8);
  EXPECT_LT(FarthestOff(truth, *rim), 0.3);
}

TEST(RimSearch, IsFoundBeforeAPlainWall) {
  const Scene truth = MakePlainScene();
  Scene wrong = truth;
  wrong.search.axis.direction = Vector3d(std::sin(1 * kDegree), std::sin(-2 * kDegree), 1).normalized();
  const auto rim = FindRim(wrong.view, wrong.search);
  ASSERT_TRUE(rim.has_value());
  EXPECT_GT(rim->share, 0.8);
  EXPECT_LT(FarthestOff(truth, *rim), 0.5);
}

TEST(RimSearch, GroundOfManyEdgesHasNone) {
  const Scene scene = MakeScene(Table::kNone);
  EXPECT_FALSE(FindRim(scene.view, scene.search).has_value());
}

TEST(RimSearch, ASquareTableHasNone) {
  const Scene scene = MakeScene(Table::kSquare);
  EXPECT_FALSE(FindRim(scene.view, scene.search).has_value());
}

}  // namespace
}  // namespace s2gs
