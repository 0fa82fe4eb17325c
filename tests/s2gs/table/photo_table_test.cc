#include "s2gs/table/photo_table.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <optional>
#include <vector>

#include "sfm_split/base/angles.h"
#include "tests/s2gs/backend/reference_render.h"
#include "tests/s2gs/table/table_on_ground.h"

namespace s2gs {
namespace {

Placement Rotating(const std::vector<Eigen::Vector3d>& places) {
  Placement placement;
  for (const Eigen::Vector3d& x : places) {
    for (int k = 0; k < 3; ++k) placement.centre.push_back(static_cast<float>(x[k]));
    placement.foreground_logit.push_back(5);
  }
  return placement;
}

TEST(PhotoTable, ItsRimIsFoundInTheMedianOfAStation) {
  const TrainingScene scene = TableOnGround(12, TopLook::kPlain);
  const std::optional<TableCircle> circle = FindTableInPhotos(scene, LoadStations(scene));
  ASSERT_TRUE(circle);
  EXPECT_NEAR(circle->radius, kTableRadius, kTablePixel);
  // From 30 degrees above, a pixel of the picture is 1.15 of height; pictures of one ray a pixel are half
  // off.
  EXPECT_NEAR(circle->height, kTableTop, 1.5 * kTablePixel);
  EXPECT_FALSE(FindTableInPhotos(scene, {}));
}

// Cameras that look down see no points of a thing's lower part.
TEST(PhotoTable, ItsRimIsFoundBelowAThingOfWhichTheUpperPartIsSeen) {
  TrainingScene scene = TableOnGround(12, TopLook::kPlain);
  scene.points.clear();
  // A fifth of the table's radius high, of which the upper three fifths are seen.
  for (int i = 0; i <= 40; ++i) {
    const Eigen::AngleAxisd turn(0.7 * i, Eigen::Vector3d::UnitZ());
    const double height = kTableTop + kTableRadius * (0.08 + 0.12 * i / 40);
    scene.points.push_back({turn * Eigen::Vector3d(0.3 * kTableRadius, 0, height), {0, 0, 0}, true});
  }
  const std::optional<TableCircle> circle = FindTableInPhotos(scene, LoadStations(scene));
  ASSERT_TRUE(circle);
  EXPECT_NEAR(circle->radius, kTableRadius, kTablePixel);
  EXPECT_NEAR(circle->height, kTableTop, 1.5 * kTablePixel);
}

// Of a plain thing there are few points, and the table's own lie on its side as well.
TEST(PhotoTable, ItsRimIsFoundBelowAThingOfFewPoints) {
  TrainingScene scene = TableOnGround(12, TopLook::kPlain);
  scene.points.clear();
  const auto add = [&](int i, double radius, double above_top) {
    const Eigen::AngleAxisd turn(0.7 * i, Eigen::Vector3d::UnitZ());
    const Eigen::Vector3d x(radius * kTableRadius, 0, kTableTop + above_top * kTableRadius);
    scene.points.push_back({turn * x, {0, 0, 0}, true});
  };
  for (int i = 0; i < 97; ++i) add(i, i < 50 ? 0.9 : 1, i < 50 ? 0 : -0.2 * (i - 50) / 46);
  for (int i = 0; i < 3; ++i) add(i, 0.2, 0.5);
  const std::optional<TableCircle> circle = FindTableInPhotos(scene, LoadStations(scene));
  ASSERT_TRUE(circle);
  EXPECT_NEAR(circle->radius, kTableRadius, kTablePixel);
  EXPECT_NEAR(circle->height, kTableTop, 1.5 * kTablePixel);
}

TEST(PhotoTable, AStationIsSomeOfItsPhotosWithoutThoseHeldOut) {
  TrainingScene scene = TableOnGround(41, TopLook::kPlain);
  for (size_t i = 0; i < 30; i += 10) scene.photos[i].held_out = true;
  scene.photos.back().station = 1;
  const std::vector<StationPhotos> stations = LoadStations(scene);
  ASSERT_EQ(stations.size(), 1U);  // one photo is no median
  EXPECT_EQ(stations[0].images.size(), 36U);
  EXPECT_EQ(stations[0].views.size(), 36U);
  for (const size_t held_out : {0, 10, 20}) {
    for (const Image8& image : stations[0].images)
      EXPECT_NE(image.pixels, scene.photos[held_out].image.pixels);
  }
  scene.region.reset();
  EXPECT_TRUE(LoadStations(scene).empty());
}

// A tripod that shakes by 3 px, in the first photo most: what most photos show lies where none of them says.
TEST(PhotoTable, AStationsPhotosAreTurnedBackToTheFirst) {
  const TrainingScene scene = TableOnGround(12, TopLook::kPlain, 3.0 / 200);
  const std::vector<StationPhotos> stations = LoadStations(scene);
  ASSERT_EQ(stations.size(), 1U);
  const PinholeView& first = stations[0].views.front();
  for (const PinholeView& view : stations[0].views) {
    const double turned = view.cam_from_world.rotation.angularDistance(first.cam_from_world.rotation);
    EXPECT_LT(turned, 0.51 / 200);
    // The table has turned by as much as before.
    const Rigid3 object_from_world = view.cam_from_object.Inverse() * view.cam_from_world;
    EXPECT_NEAR((object_from_world.rotation * Eigen::Vector3d::UnitZ()).z(), 1, 1e-9);
  }
  const std::optional<TableCircle> circle = FindTableInPhotos(scene, stations);
  ASSERT_TRUE(circle);
  EXPECT_NEAR(circle->radius, kTableRadius, kTablePixel);
  EXPECT_NEAR(circle->height, kTableTop, 1.5 * kTablePixel);
}

// Automatic exposure and white balance: where photos differ by it, a median is of none of them.
// Twelve megapixels become 480 px on the longer side, and small photos stay as they are.
TEST(PhotoTable, LargePhotosAreLookedAtReduced) {
  ScenePhoto photo;
  photo.view.width = 4000;
  photo.view.height = 3000;
  photo.view.fx = photo.view.fy = 5000;
  photo.view.cx = 2000;
  photo.view.cy = 1500;
  const PinholeView reduced = StationView(photo);
  EXPECT_EQ(reduced.width, 480);
  EXPECT_EQ(reduced.height, 360);
  EXPECT_NEAR(reduced.fx, 600, 1e-9);
  EXPECT_NEAR(reduced.cx, 240, 1e-9);
  EXPECT_NEAR(reduced.cy, 180, 1e-9);
  photo.view.width = 320;
  photo.view.height = 480;
  EXPECT_EQ(StationView(photo).width, 320);
  EXPECT_EQ(StationView(photo).height, 480);
}

TEST(PhotoTable, AStationsPhotosAreOfOneExposure) {
  TrainingScene scene = TableOnGround(12, TopLook::kPlain);
  const StationPhotos before = LoadStations(scene).front();
  for (size_t i = 0; i < scene.photos.size(); ++i) {
    std::vector<uint8_t>& pixels = scene.photos[i].image.pixels;
    for (size_t p = 0; p < pixels.size(); ++p) {
      const double gain = std::pow(1.2, std::sin(3.0 * static_cast<double>(i) + static_cast<double>(p % 3)));
      pixels[p] = static_cast<uint8_t>(std::lround(pixels[p] * gain));
    }
  }
  const StationPhotos after = LoadStations(scene).front();
  std::vector<double> changes;
  for (size_t i = 0; i < after.images.size(); ++i) {
    for (size_t p = 0; p < after.still.pixels.size(); ++p)
      changes.push_back(std::abs(after.images[i].pixels[p] - before.images[i].pixels[p]));
  }
  // Rounding twice, and the mean gain, which stays.
  std::sort(changes.begin(), changes.end());
  EXPECT_LT(changes[changes.size() * 9 / 10], 3);
  const std::optional<TableCircle> circle = FindTableInPhotos(scene, {after});
  ASSERT_TRUE(circle);
  EXPECT_NEAR(circle->radius, kTableRadius, kTablePixel);
}

// What the model takes to turn of the top, or of the side: whichever stands still more counts.
TEST(PhotoTable, TheStaticShareIsThatOfTheTopOrTheSide) {
  const TrainingScene scene = TableOnGround(12, TopLook::kPlain);
  const TableCircle circle = {kTableTop, kTableRadius, 0.9, 1e-4, kTableBottom};
  const auto splat = [](const Eigen::Vector3d& x, const Eigen::Vector3d& normal) {
    ReferenceGaussian g{};
    for (int k = 0; k < 3; ++k) g[kRefCentre + k] = x[k];
    g[kRefLogScale] = g[kRefLogScale + 1] = std::log(0.05);
    const Eigen::Quaterniond q = Eigen::Quaterniond::FromTwoVectors(Eigen::Vector3d::UnitZ(), normal);
    g[kRefRotation] = q.w();
    for (int k = 0; k < 3; ++k) g[kRefRotation + 1 + k] = q.vec()[k];
    g[kRefOpacity] = 8;
    g[kRefForeground] = 10;
    return g;
  };
  const auto share = [&](bool has_top, bool has_side) {
    std::vector<ReferenceGaussian> splats = {splat({0, 0, 0.5}, Eigen::Vector3d::UnitZ())};
    for (int i = -20; i <= 20 && has_top; ++i) {
      for (int j = -20; j <= 20; ++j)
        if (std::hypot(i, j) <= 20)
          splats.push_back(splat({0.05 * i, 0.05 * j, kTableTop}, Eigen::Vector3d::UnitZ()));
    }
    for (int i = 0; i < 120 && has_side; ++i) {
      const Eigen::Vector3d outwards(std::cos(2 * kPi * i / 120), std::sin(2 * kPi * i / 120), 0);
      for (double z = kTableBottom; z <= kTableTop; z += 0.05)
        splats.push_back(splat(outwards + z * Eigen::Vector3d::UnitZ(), outwards));
    }
    const std::unique_ptr<Backend> backend = MakeCpuBackend(1);
    TrainState state;
    state.gaussians = FromReference(splats, 0);
    backend->SetState(state);
    const TableRim rim = RimOfCircle(scene, circle, std::nullopt, backend.get());
    EXPECT_EQ(rim.region.radius, kTableRadius);
    EXPECT_EQ(rim.region.low, kTableBottom);
    EXPECT_EQ(rim.region.high, kTableTop);
    EXPECT_EQ(rim.share, 0.9);
    EXPECT_EQ(rim.false_alarms, 1e-4);
    return rim.static_share;
  };
  EXPECT_LT(share(true, true), 0.1);
  EXPECT_GT(share(true, false), 0.5);
  EXPECT_GT(share(false, true), 0.5);
  EXPECT_GT(share(false, false), 0.9);
}

TEST(PhotoTable, TextureIsWhatMostPhotosShowBesideNoise) {
  const double plain = TexturedShareOfTop(LoadStations(TableOnGround(12, TopLook::kPlain)), TableRegion());
  // The card and the half patches about it: .65 x .8 of 2.3, which is the top without as much at its rim.
  EXPECT_NEAR(plain, 0.23, 0.06);
  EXPECT_GT(TexturedShareOfTop(LoadStations(TableOnGround(12, TopLook::kTiled)), TableRegion()), 0.95);
  EXPECT_EQ(TexturedShareOfTop({}, TableRegion()), 1);
}

// Gaussians around the table, lower than its top: on the leaf, and on ground that stands still.
// A place of the ground next to the table, which training lets turn where a shadow passes: in most of the
// photos that show it it lies in the shadow. Where what passes is of another tint, it may hang down from the
// table; and where all photos show less light.
TEST(PhotoTable, GroundInShadowsThatComeAndGoStands) {
  const Eigen::Vector3d place(1.15 * std::cos(0.45), 1.15 * std::sin(0.45), -0.15);
  const auto stand_where = [&](const std::array<double, 3>& factors, size_t one_in_light) {
    TrainingScene scene = TableOnGround(12, TopLook::kPlain);
    size_t seen = 0;
    for (ScenePhoto& photo : scene.photos) {
      const Eigen::Vector3d in_cam = photo.view.cam_from_object * place;
      const Eigen::Vector2d pixel = PixelOf(photo.view, in_cam).value();
      if (one_in_light > 0 && seen++ % one_in_light == 0) continue;
      for (int y = static_cast<int>(pixel.y()) - 3; y <= pixel.y() + 3; ++y) {
        for (int x = static_cast<int>(pixel.x()) - 3; x <= pixel.x() + 3; ++x) {
          uint8_t* rgb = photo.image.Pixel(x, y);
          for (int c = 0; c < 3; ++c) rgb[c] = static_cast<uint8_t>(std::lround(rgb[c] * factors[c]));
        }
      }
    }
    return FindStandingAroundTable(LoadStations(scene), TableRegion(), Rotating({place}), {}).size() == 1;
  };
  EXPECT_TRUE(stand_where({1, 1, 1}, 3));
  EXPECT_TRUE(stand_where({0.6, 0.6, 0.6}, 3));
  EXPECT_FALSE(stand_where({0.6, 0.6, 0.3}, 3));
  EXPECT_FALSE(stand_where({0.3, 0.3, 0.3}, 0));
}

TEST(PhotoTable, GroundAroundItStandsAndALeafThatHangsDownTurns) {
  std::vector<Eigen::Vector3d> places;
  for (int i = -2; i <= 2; ++i) places.emplace_back(kTableLeafAt, 0.08 * i, -0.09);
  const size_t num_leaf = places.size();
  for (double angle = 0.6; angle < 2 * kPi - 0.6; angle += 0.1)
    places.emplace_back(1.15 * std::cos(angle), 1.15 * std::sin(angle), -0.1);
  places.emplace_back(0.2, 0.5, -0.19);  // under the table
  const size_t num_low = places.size();
  for (double angle = 0; angle < 2 * kPi; angle += 0.5) {
    places.emplace_back(std::cos(angle), std::sin(angle), 0);                      // on its side
    places.emplace_back(0.9 * std::cos(angle), 0.9 * std::sin(angle), kTableTop);  // on its top
  }
  Placement gaussians = Rotating(places);
  const std::vector<StationPhotos> stations = LoadStations(TableOnGround(12, TopLook::kPlain));
  const std::vector<uint32_t> standing = FindStandingAroundTable(stations, TableRegion(), gaussians, {});
  std::vector<uint32_t> expected;
  for (size_t i = num_leaf; i < num_low; ++i) expected.push_back(static_cast<uint32_t>(i));
  EXPECT_EQ(standing, expected);

  std::fill(gaussians.foreground_logit.begin(), gaussians.foreground_logit.end(), -5.0F);
  EXPECT_TRUE(FindStandingAroundTable(stations, TableRegion(), gaussians, {}).empty());
  EXPECT_TRUE(FindStandingAroundTable({}, TableRegion(), Rotating(places), {}).empty());
}

// Gaussians beyond the rim, higher than the top, where photos show nothing but tiled ground.
TEST(PhotoTable, WhatReachesBeyondItStandsWherePhotosShowTheGroundsTexture) {
  std::vector<Eigen::Vector3d> places;
  for (double angle = 0; angle < 2 * kPi; angle += 0.1)
    places.emplace_back(1.2 * std::cos(angle), 1.2 * std::sin(angle), 0.15);
  const Placement gaussians = Rotating(places);
  std::vector<StationPhotos> stations = LoadStations(TableOnGround(12, TopLook::kPlain));
  const std::vector<uint32_t> standing = FindStandingAroundTable(stations, TableRegion(), gaussians, {});
  // Half a tile is plain between its borders.
  EXPECT_GT(standing.size(), places.size() / 3);
  // Photos of plain things alone, in which a round one may reach so far.
  for (StationPhotos& station : stations) {
    for (Image8& image : station.images) std::fill(image.pixels.begin(), image.pixels.end(), uint8_t{120});
    station.still = station.images.front();
  }
  EXPECT_TRUE(FindStandingAroundTable(stations, TableRegion(), gaussians, {}).empty());
  // None does where three points of things are over the top and within the rim. Those below the top, or
  // fewer, do not tell; and one that is beyond it tells the contrary.
  std::vector<Eigen::Vector3d> of_things = {{0, 0, 0.2}, {0.3, 0, 0.2}, {1.2, 0, kTableTop - 0.05}};
  EXPECT_TRUE(FindStandingAroundTable(stations, TableRegion(), gaussians, of_things).empty());
  of_things.emplace_back(0, 0.9, 0.2);
  EXPECT_EQ(FindStandingAroundTable(stations, TableRegion(), gaussians, of_things).size(), places.size());
  of_things.emplace_back(0, 1.1, 0.2);
  EXPECT_TRUE(FindStandingAroundTable(stations, TableRegion(), gaussians, of_things).empty());
}

// A camera that was touched shows other ground in the same pixels, which is no change.
TEST(PhotoTable, PhotosOfACameraThatTurnedAsideDoNotCount) {
  std::vector<Eigen::Vector3d> places;
  for (double angle = 0.6; angle < 2 * kPi - 0.6; angle += 0.1)
    places.emplace_back(1.15 * std::cos(angle), 1.15 * std::sin(angle), -0.1);
  std::vector<StationPhotos> stations = LoadStations(TableOnGround(12, TopLook::kPlain));
  // Two thirds of the photos, after the median was taken: as if their pictures had moved by 6 px.
  for (size_t i = 1; i < stations[0].views.size(); ++i) {
    if (i % 3 == 0) continue;
    PinholeView& view = stations[0].views[i];
    view.cx += 6;
    Image8& image = stations[0].images[i];
    const Image8 before = image;
    for (int y = 0; y < kTablePhotoHeight; ++y) {
      for (int x = 6; x < kTablePhotoWidth; ++x) std::copy_n(before.Pixel(x - 6, y), 3, image.Pixel(x, y));
    }
  }
  const std::vector<uint32_t> standing =
      FindStandingAroundTable(stations, TableRegion(), Rotating(places), {});
  EXPECT_EQ(standing.size(), places.size());
}

}  // namespace
}  // namespace s2gs
