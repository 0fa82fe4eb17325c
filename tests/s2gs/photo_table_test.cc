#include "s2gs/photo_table.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <optional>
#include <vector>

#include "s2gs/core/rng.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/reporter.h"
#include "tests/support/view_from_above.h"

namespace s2gs {
namespace {

constexpr int kWidth = 240;
constexpr int kHeight = 180;
constexpr double kFocal = 200;
constexpr double kDistance = 5;
constexpr double kTop = 0.1;
constexpr double kBottom = -0.15;
constexpr double kRadius = 1;
constexpr double kGround = -0.2;
constexpr double kPixel = kDistance / kFocal;
// A leaf that hangs upright beside the table, across the x axis of the object.
constexpr double kLeafAt = 1.25;
constexpr double kLeafHalfWidth = 0.25;

// A grey value of each tile of this size, from 20 to 220.
double TileAt(uint64_t seed, double size, double x, double y) {
  const auto i = static_cast<uint64_t>(std::floor(x / size) + 1000);
  const auto j = static_cast<uint64_t>(std::floor(y / size) + 1000);
  return 20 + 200 * static_cast<double>(UnitFloat(RandomBits(seed, i, j).words[0]));
}

enum class Top : uint8_t { kPlain, kTiled };

// A table that has turned by `angle` above ground that stands still, with a tiled card on a twelfth of its
// top.
double GreyAlong(const Rigid3& object_from_cam, const Rigid3& world_from_cam, const Eigen::Vector3d& in_cam,
                 Top top) {
  const Eigen::Vector3d from = object_from_cam.translation;
  const Eigen::Vector3d ray = object_from_cam.rotation * in_cam;
  const auto at_height = [&](double height) -> Eigen::Vector3d {
    return from + (height - from.z()) / ray.z() * ray;
  };
  const Eigen::Vector3d on_top = at_height(kTop);
  const bool is_top = on_top.head<2>().norm() < kRadius;
  const double to_leaf = (kLeafAt - from.x()) / ray.x();
  const Eigen::Vector3d on_leaf = from + to_leaf * ray;
  const bool is_leaf = to_leaf > 0 && std::abs(on_leaf.y()) < kLeafHalfWidth && on_leaf.z() < 0 &&
                       on_leaf.z() > kGround + 0.02;
  const bool leaf_first = is_leaf && (!is_top || to_leaf < (on_top - from).norm() / ray.norm());
  if (leaf_first) return TileAt(3, 0.08, on_leaf.y(), on_leaf.z());
  if (is_top) {
    const bool is_card = std::abs(on_top.x()) < 0.25 && std::abs(on_top.y()) < 0.25;
    return is_card || top == Top::kTiled ? TileAt(2, 0.06, on_top.x(), on_top.y()) : 150;
  }
  for (double z = kTop; z > kBottom; z -= 0.004) {
    if (at_height(z).head<2>().norm() < kRadius) return 90;
  }
  const Eigen::Vector3d in_world = world_from_cam.rotation * in_cam;
  const Eigen::Vector3d on_ground =
      world_from_cam.translation + (kGround - world_from_cam.translation.z()) / in_world.z() * in_world;
  return TileAt(1, 0.4, on_ground.x(), on_ground.y());
}

ScenePhoto PhotoAt(double angle, Top top, uint64_t seed) {
  ScenePhoto photo;
  PinholeView& view = photo.view;
  view = ViewFromAbove(kWidth, kHeight, kFocal, 0.3, kDistance);
  const Rigid3 world_from_object{Eigen::Quaterniond(Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitZ())),
                                 Eigen::Vector3d::Zero()};
  view.cam_from_object = view.cam_from_world * world_from_object;
  const Rigid3 world_from_cam = view.cam_from_world.Inverse();
  const Rigid3 object_from_cam = view.cam_from_object.Inverse();
  photo.image = {kWidth, kHeight, 3, {}};
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const Eigen::Vector3d in_cam((x + 0.5 - view.cx) / view.fx, (y + 0.5 - view.cy) / view.fy, 1);
      const double noise = 4 * static_cast<double>(UnitFloat(RandomBits(seed, x, y).words[0])) - 2;
      const double grey = GreyAlong(object_from_cam, world_from_cam, in_cam, top) + noise;
      for (int c = 0; c < 3; ++c) photo.image.pixels.push_back(static_cast<uint8_t>(std::lround(grey)));
    }
  }
  return photo;
}

TrainingScene SceneOf(int num_photos, Top top) {
  TrainingScene scene;
  scene.mode = TrainMode::kS2gs;
  scene.axis = TurntableAxis();
  scene.region = RotatingRegion{TurntableAxis(), 2, -0.5, 1};
  for (int i = 0; i < num_photos; ++i) scene.photos.push_back(PhotoAt(2 * kPi * i / num_photos, top, 10 + i));
  for (int i = 0; i <= 10; ++i) {
    const double height = kTop + 0.05 * i;
    scene.points.push_back({{0.3, 0.1 * (i % 3), height}, {0, 0, 0}, true});
  }
  return scene;
}

std::vector<StationPhotos> Load(const TrainingScene& scene) {
  Reporter silent;
  return LoadStationPhotos(
      scene, [](const ScenePhoto& photo) { return photo.image; }, silent);
}

RotatingRegion Table() { return {TurntableAxis(), kRadius, kBottom, kTop}; }

Placement Rotating(const std::vector<Eigen::Vector3d>& places) {
  Placement placement;
  for (const Eigen::Vector3d& x : places) {
    for (int k = 0; k < 3; ++k) placement.centre.push_back(static_cast<float>(x[k]));
    placement.foreground_logit.push_back(5);
  }
  return placement;
}

TEST(PhotoTable, ItsRimIsFoundInTheMedianOfAStation) {
  const TrainingScene scene = SceneOf(12, Top::kPlain);
  const std::optional<TableCircle> circle = FindTableInPhotos(scene, Load(scene));
  ASSERT_TRUE(circle);
  EXPECT_NEAR(circle->radius, kRadius, kPixel);
  // From 30 degrees above, a pixel of the picture is 1.15 of height; pictures of one ray a pixel are half
  // off.
  EXPECT_NEAR(circle->height, kTop, 1.5 * kPixel);
  EXPECT_FALSE(FindTableInPhotos(scene, {}));
}

TEST(PhotoTable, AStationIsSomeOfItsPhotosWithoutThoseHeldOut) {
  TrainingScene scene = SceneOf(30, Top::kPlain);
  for (size_t i = 0; i < scene.photos.size(); i += 10) scene.photos[i].held_out = true;
  scene.photos.back().station = 1;
  const std::vector<StationPhotos> stations = Load(scene);
  ASSERT_EQ(stations.size(), 1U);  // one photo is no median
  EXPECT_EQ(stations[0].images.size(), 15U);
  EXPECT_EQ(stations[0].views.size(), 15U);
  for (const size_t held_out : {0, 10, 20}) {
    for (const Image8& image : stations[0].images)
      EXPECT_NE(image.pixels, scene.photos[held_out].image.pixels);
  }
  scene.region.reset();
  EXPECT_TRUE(Load(scene).empty());
}

TEST(PhotoTable, TextureIsWhatMostPhotosShowBesideNoise) {
  const double plain = TexturedShareOfTop(Load(SceneOf(12, Top::kPlain)), Table());
  // The card and the half patches about it: .65 x .8 of 2.3, which is the top without as much at its rim.
  EXPECT_NEAR(plain, 0.23, 0.06);
  EXPECT_GT(TexturedShareOfTop(Load(SceneOf(12, Top::kTiled)), Table()), 0.95);
  EXPECT_EQ(TexturedShareOfTop({}, Table()), 1);
}

// Gaussians around the table, lower than its top: on the leaf, and on ground that stands still.
TEST(PhotoTable, GroundAroundItStandsAndALeafThatHangsDownTurns) {
  std::vector<Eigen::Vector3d> places;
  for (int i = -2; i <= 2; ++i) places.emplace_back(kLeafAt, 0.08 * i, -0.09);
  const size_t num_leaf = places.size();
  for (double angle = 0.6; angle < 2 * kPi - 0.6; angle += 0.1)
    places.emplace_back(1.15 * std::cos(angle), 1.15 * std::sin(angle), -0.1);
  places.emplace_back(0.2, 0.5, -0.19);  // under the table
  const size_t num_low = places.size();
  for (double angle = 0; angle < 2 * kPi; angle += 0.5) {
    places.emplace_back(std::cos(angle), std::sin(angle), 0);                 // on its side
    places.emplace_back(0.9 * std::cos(angle), 0.9 * std::sin(angle), kTop);  // on its top
    places.emplace_back(1.2 * std::cos(angle), 1.2 * std::sin(angle), 0.3);   // reaching beyond it
  }
  Placement gaussians = Rotating(places);
  const std::vector<StationPhotos> stations = Load(SceneOf(12, Top::kPlain));
  const std::vector<uint32_t> standing = FindStandingAroundTable(stations, Table(), gaussians);
  std::vector<uint32_t> expected;
  for (size_t i = num_leaf; i < num_low; ++i) expected.push_back(static_cast<uint32_t>(i));
  EXPECT_EQ(standing, expected);

  std::fill(gaussians.foreground_logit.begin(), gaussians.foreground_logit.end(), -5.0F);
  EXPECT_TRUE(FindStandingAroundTable(stations, Table(), gaussians).empty());
  EXPECT_TRUE(FindStandingAroundTable({}, Table(), Rotating(places)).empty());
}

// A camera that was touched shows other ground in the same pixels, which is no change.
TEST(PhotoTable, PhotosOfACameraThatTurnedAsideDoNotCount) {
  std::vector<Eigen::Vector3d> places;
  for (double angle = 0.6; angle < 2 * kPi - 0.6; angle += 0.1)
    places.emplace_back(1.15 * std::cos(angle), 1.15 * std::sin(angle), -0.1);
  std::vector<StationPhotos> stations = Load(SceneOf(12, Top::kPlain));
  // Two thirds of the photos, after the median was taken: as if their pictures had moved by 6 px.
  for (size_t i = 1; i < stations[0].views.size(); ++i) {
    if (i % 3 == 0) continue;
    PinholeView& view = stations[0].views[i];
    view.cx += 6;
    Image8& image = stations[0].images[i];
    const Image8 before = image;
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 6; x < kWidth; ++x) std::copy_n(before.Pixel(x - 6, y), 3, image.Pixel(x, y));
    }
  }
  const std::vector<uint32_t> standing = FindStandingAroundTable(stations, Table(), Rotating(places));
  EXPECT_EQ(standing.size(), places.size());
}

}  // namespace
}  // namespace s2gs
