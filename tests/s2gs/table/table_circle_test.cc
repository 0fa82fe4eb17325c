#include "s2gs/table/table_circle.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <functional>
#include <optional>
#include <vector>

#include "s2gs/core/rng.h"
#include "s2gs/table/opaque_region.h"
#include "sfm_split/base/angles.h"
#include "tests/support/camera_towards_origin.h"
#include "tests/support/view_from_above.h"

namespace s2gs {
namespace {

constexpr int kWidth = 240;
constexpr int kHeight = 180;
constexpr double kFocal = 260;
constexpr double kDistance = 5;
constexpr double kTop = 0.1;
constexpr double kSideEnd = -0.15;
constexpr double kRadius = 1;
constexpr double kGround = -0.2;
// Of a pixel of a table, across it.
constexpr double kPixel = kDistance / kFocal;

PinholeView ViewFrom(double azimuth) { return ViewFromAbove(kWidth, kHeight, kFocal, azimuth, kDistance); }

// Grey values of tiles on the ground, each other than the next.
int TileAt(const Eigen::Vector3d& x) {
  const auto i = static_cast<uint64_t>(std::floor(x.x() / 0.4) + 1000);
  const auto j = static_cast<uint64_t>(std::floor(x.y() / 0.4) + 1000);
  return static_cast<int>(20 + 200 * UnitFloat(RandomBits(7, i, j).words[0]));
}

using Outline = std::function<bool(double, double)>;

bool IsInCircle(double x, double y) { return std::hypot(x, y) < kRadius; }

// A plain thing of this outline above the ground, with noise. Of each pixel four rays.
Image8 PictureOf(const PinholeView& view, const Outline& is_inside, int grey_of_top, int grey_of_side,
                 const std::function<int(const Eigen::Vector3d&)>& grey_of_ground = TileAt) {
  const Rigid3 world_from_cam = view.cam_from_world.Inverse();
  const auto grey_along = [&](double u, double v) {
    const Eigen::Vector3d ray =
        world_from_cam.rotation * Eigen::Vector3d((u - view.cx) / view.fx, (v - view.cy) / view.fy, 1);
    const auto at = [&](double height) -> Eigen::Vector3d {
      return world_from_cam.translation + (height - world_from_cam.translation.z()) / ray.z() * ray;
    };
    if (is_inside(at(kTop).x(), at(kTop).y())) return grey_of_top;
    for (double z = kTop; z > kSideEnd; z -= 0.002) {
      if (is_inside(at(z).x(), at(z).y())) return grey_of_side;
    }
    return grey_of_ground(at(kGround));
  };
  Image8 image{view.width, view.height, 3, {}};
  for (int y = 0; y < view.height; ++y) {
    for (int x = 0; x < view.width; ++x) {
      double sum = 0;
      for (const double du : {0.25, 0.75}) {
        for (const double dv : {0.25, 0.75}) sum += grey_along(x + du, y + dv) / 4.0;
      }
      const float noise = UnitFloat(RandomBits(3, x, y).words[0]) - 0.5F;
      for (int c = 0; c < 3; ++c) image.pixels.push_back(static_cast<uint8_t>(sum + 4 * noise + 0.5));
    }
  }
  return image;
}

CircleSearch SearchAboutTop() {
  CircleSearch search;
  search.low = -0.4;
  search.high = 0.5;
  search.max_radius = 1.6;
  return search;
}

TEST(TableCircle, OfAPlainTableIsFoundByOneCamera) {
  const PinholeView view = ViewFrom(0.3);
  const std::optional<TableCircle> circle =
      FindTableCircle({{view, PictureOf(view, IsInCircle, 150, 90)}}, SearchAboutTop());
  ASSERT_TRUE(circle);
  // A pixel of height is half a pixel of the picture from 30 degrees above.
  EXPECT_NEAR(circle->height, kTop, kPixel);
  EXPECT_NEAR(circle->radius, kRadius, kPixel);
  EXPECT_LT(circle->false_alarms, 1e-6);
  ASSERT_TRUE(circle->side_end);
  EXPECT_NEAR(*circle->side_end, kSideEnd, 1.5 * kPixel);
}

// From 8 degrees above, a pixel at the far rim is seven of height or radius, and next to it a thing ends that
// stands on the top. Measured .003 and .001; where each direction counted alike by radius .008 and .002.
TEST(TableCircle, OfATableSeenByALowCamera) {
  constexpr double kElevation = 8 * kPi / 180;
  PinholeView view = ViewFrom(0.3);
  view.cam_from_world =
      CameraTowardsOrigin(kDistance * Eigen::Vector3d(std::cos(kElevation), 0, std::sin(kElevation)));
  constexpr int kHalfThing = 20;  // [px], of a radius of 52
  for (const int end : {79, 80}) {
    Image8 picture = PictureOf(view, IsInCircle, 150, 90);
    for (int y = 40; y < end; ++y)
      std::fill_n(picture.Pixel(kWidth / 2 - kHalfThing, y), 3 * 2 * kHalfThing, 60);
    const std::optional<TableCircle> circle = FindTableCircle({{view, picture}}, SearchAboutTop());
    ASSERT_TRUE(circle);
    EXPECT_NEAR(circle->height, kTop, 0.0015);
    EXPECT_NEAR(circle->radius, kRadius, 0.005);
  }
}

// The ground is as plain and pale as the table, so that the rim is an edge of seven grey levels with noise of
// two, and most of what lies within it is a thing that has texture.
TEST(TableCircle, OfAPaleTableUnderABusyThing) {
  const PinholeView view = ViewFrom(0.3);
  Image8 picture = PictureOf(view, IsInCircle, 150, 140, [](const Eigen::Vector3d&) { return 157; });
  PixelMask thing{view.width, view.height, std::vector<uint8_t>(picture.pixels.size() / 3, 0)};
  AddRegion({TurntableAxis(), 0.6 * kRadius, kTop, kTop + 0.2}, view, &thing);
  for (size_t i = 0; i < thing.inside.size(); ++i) {
    const size_t x = i % kWidth / 4;
    const size_t y = i / kWidth / 4;
    if (thing.inside[i] == 0) continue;
    const auto grey = static_cast<uint8_t>(20 + 200 * UnitFloat(RandomBits(11, x, y).words[0]));
    for (size_t c = 0; c < 3; ++c) picture.pixels[3 * i + c] = grey;
  }
  const std::optional<TableCircle> circle = FindTableCircle({{view, picture}}, SearchAboutTop());
  ASSERT_TRUE(circle);
  // Measured 1.3: noise moves so pale an edge.
  EXPECT_NEAR(circle->height, kTop, 2 * kPixel);
  EXPECT_NEAR(circle->radius, kRadius, kPixel);
  EXPECT_LT(circle->false_alarms, 1e-6);
}

// A busy thing lies on the near half, nearly to the rim, and more than half of the surface just within the
// rim is its. Beyond the far half, where the top is even, seven grey levels are an edge all the same.
TEST(TableCircle, OfAPaleTableThatAThingHalfCovers) {
  const PinholeView view = ViewFrom(0.3);
  Image8 picture = PictureOf(view, IsInCircle, 150, 60, [](const Eigen::Vector3d&) { return 157; });
  PixelMask thing{view.width, view.height, std::vector<uint8_t>(picture.pixels.size() / 3, 0)};
  AddRegion({TurntableAxis(), 0.94 * kRadius, kTop, kTop}, view, &thing);
  const Eigen::Vector3d middle = view.cam_from_world * (kTop * Eigen::Vector3d::UnitZ());
  const double row = view.cy + view.fy * middle.y() / middle.z();
  for (size_t i = 0; i < thing.inside.size(); ++i) {
    const size_t y = i / kWidth;
    if (thing.inside[i] == 0 || static_cast<double>(y) < row - 4) continue;
    const float random = UnitFloat(RandomBits(11, i % kWidth / 4, y / 4).words[0]);
    std::fill_n(&picture.pixels[3 * i], 3, static_cast<uint8_t>(130 + 40 * random));
  }
  CircleSearch search = SearchAboutTop();
  search.low = 0;  // over the end of its side, which is as clear
  const std::optional<TableCircle> circle = FindTableCircle({{view, picture}}, search);
  ASSERT_TRUE(circle);
  EXPECT_NEAR(circle->height, kTop, kPixel);
  EXPECT_NEAR(circle->radius, kRadius, kPixel);
  EXPECT_LT(circle->false_alarms, 1e-6);
}

// A plain table, and above its top a dark round thing, as a station's photos show them all.
Image8 PictureBehindThing(const PinholeView& view, double radius, CircleSearch* search) {
  constexpr double kFrom = 0.25;  // over the top
  constexpr double kTo = 1.5;
  Image8 picture = PictureOf(view, IsInCircle, 150, 90);
  PixelMask thing{view.width, view.height, std::vector<uint8_t>(picture.pixels.size() / 3, 0)};
  AddRegion({TurntableAxis(), radius, kTop + kFrom, kTop + kTo}, view, &thing);
  for (size_t i = 0; i < thing.inside.size(); ++i) {
    if (thing.inside[i] != 0) std::fill_n(&picture.pixels[3 * i], 3, 60);
  }
  for (double height = kFrom; height < kTo; height += 0.1) search->thing.push_back({kTop + height, radius});
  return picture;
}

// It hides a part of the far side of the rim, and a strip as grey as the top hangs over the near side: an
// edge shows in less than .6 of the directions, but in most of those that the thing leaves free.
TEST(TableCircle, OfATableBehindAThing) {
  const PinholeView view = ViewFrom(0.3);
  CircleSearch search = SearchAboutTop();
  Image8 picture = PictureBehindThing(view, 0.6, &search);
  constexpr int kHalfStrip = 16;  // [px], of a radius of 52
  for (int y = kHeight / 2 + 1; y < kHeight; ++y)
    std::fill_n(picture.Pixel(kWidth / 2 - kHalfStrip + 1, y), 3 * (2 * kHalfStrip - 1), 150);
  EXPECT_FALSE(FindTableCircle({{view, picture}}, SearchAboutTop()));
  const std::optional<TableCircle> circle = FindTableCircle({{view, picture}}, search);
  ASSERT_TRUE(circle);
  EXPECT_NEAR(circle->height, kTop, kPixel);
  EXPECT_NEAR(circle->radius, kRadius, kPixel);
  EXPECT_GT(circle->share, 0.6);
  // What stands elsewhere hides nothing.
  for (ThingRing& ring : search.thing) ring.radius = 0.1;
  EXPECT_FALSE(FindTableCircle({{view, picture}}, search));
}

// Ground as pale as the top lies behind the table, so that somewhat more than the near half of its rim is
// seen: by three cameras, as one alone might make as much of noise.
TEST(TableCircle, OfATableBeforeGroundOfItsColour) {
  std::vector<StillPicture> pictures;
  for (const double azimuth : {0.3, 1.9, 3.6}) {
    const PinholeView view = ViewFrom(azimuth);
    Image8 picture = PictureOf(view, IsInCircle, 150, 90);
    const Eigen::Vector3d middle = view.cam_from_world * (kTop * Eigen::Vector3d::UnitZ());
    const auto last_row = static_cast<int>(view.cy + view.fy * middle.y() / middle.z()) - 8;
    for (int y = 0; y < last_row; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        std::fill_n(picture.Pixel(x, y), 3, uint8_t{150});
      }
    }
    pictures.push_back({view, picture});
  }
  const std::optional<TableCircle> circle = FindTableCircle(pictures, SearchAboutTop());
  ASSERT_TRUE(circle);
  EXPECT_NEAR(circle->height, kTop, kPixel);
  EXPECT_NEAR(circle->radius, kRadius, kPixel);
  EXPECT_LT(circle->share, 0.6);  // measured .56, expected 4e-25 times by chance
  EXPECT_FALSE(FindTableCircle({pictures[0]}, SearchAboutTop()));
}

// Where it hides most of the far side, what is left would do for the side's lower end, too, whose near half
// alone is seen.
TEST(TableCircle, NoneOfASidesLowerEndBehindAThing) {
  const PinholeView view = ViewFrom(0.3);
  CircleSearch search = SearchAboutTop();
  const Image8 picture = PictureBehindThing(view, 0.96, &search);
  EXPECT_FALSE(FindTableCircle({{view, picture}}, search));
}

// Light falls on the top and the ground in patches: no rim by light is clearer than their borders, which are
// no edge of tint.
TEST(TableCircle, OfATableInPatchyLightByItsTint) {
  const PinholeView view = ViewFrom(0.3);
  const auto in_patches = [&](double blue_of_ground) {
    Image8 picture = PictureOf(view, IsInCircle, 150, 150, [](const Eigen::Vector3d&) { return 50; });
    for (size_t i = 0; i < picture.pixels.size(); i += 3) {
      const size_t patch_x = i / 3 % kWidth / 6;
      const size_t patch_y = i / 3 / kWidth / 6;
      const double light = 0.6 + 0.6 * UnitFloat(RandomBits(13, patch_x, patch_y).words[0]);
      const bool is_ground = picture.pixels[i] < 100;
      for (size_t c = 0; c < 3; ++c) {
        const double blue = is_ground && c == 2 ? blue_of_ground : 0;
        const double noise = 2 * UnitFloat(RandomBits(17, i, c).words[0]) - 1;
        picture.pixels[i + c] = static_cast<uint8_t>(light * (150 + blue) + noise + 0.5);
      }
    }
    return FindTableCircle({{view, picture}}, SearchAboutTop());
  };
  const std::optional<TableCircle> circle = in_patches(20);
  ASSERT_TRUE(circle);
  EXPECT_NEAR(circle->height, kTop, 2 * kPixel);
  EXPECT_NEAR(circle->radius, kRadius, kPixel);
  EXPECT_FALSE(in_patches(0));
}

// What lies left of the table has its side's own grey: nearly half of the lines down the side end elsewhere.
TEST(TableCircle, ItsSideEndsWhereMoreThanHalfOfItDoes) {
  const auto with_grey_until = [](double radii, const std::vector<double>& azimuths) {
    std::vector<StillPicture> pictures;
    for (const double azimuth : azimuths) {
      const PinholeView view = ViewFrom(azimuth);
      Image8 picture = PictureOf(view, IsInCircle, 150, 90);
      PixelMask top{view.width, view.height, std::vector<uint8_t>(picture.pixels.size() / 3, 0)};
      AddRegion({TurntableAxis(), kRadius, kTop, kTop}, view, &top);
      const double column = view.cx + radii * kRadius / kPixel;
      for (size_t i = 0; i < picture.pixels.size(); ++i) {
        const auto x = static_cast<double>(i / 3 % static_cast<size_t>(view.width));
        if (x < column && top.inside[i / 3] == 0) picture.pixels[i] = 90;
      }
      pictures.push_back({view, picture});
    }
    return FindTableCircle(pictures, SearchAboutTop());
  };
  // 7 and 5 of 12 lines of each picture.
  const std::vector<double> three = {0.3, 1.9, 3.6};
  const std::optional<TableCircle> most = with_grey_until(-0.3, three);
  ASSERT_TRUE(most);
  ASSERT_TRUE(most->side_end);
  EXPECT_NEAR(*most->side_end, kSideEnd, 1.5 * kPixel);
  const std::optional<TableCircle> few = with_grey_until(0.1, three);
  ASSERT_TRUE(few);
  EXPECT_FALSE(few->side_end);
  // Of one picture alone more have to: a side of 52 steps, the first six of which do not count, has a chance
  // of 9 / 46 that a line ends within four of another. Ten of twelve are expected 2e-4 times, nine 2e-3
  // times.
  const std::optional<TableCircle> ten = with_grey_until(-0.65, {0.3});
  ASSERT_TRUE(ten);
  ASSERT_TRUE(ten->side_end);
  EXPECT_NEAR(*ten->side_end, kSideEnd, 1.5 * kPixel);
  const std::optional<TableCircle> nine = with_grey_until(-0.52, {0.3});
  ASSERT_TRUE(nine);
  EXPECT_FALSE(nine->side_end);
}

// Compression leaves tints in patches on a grey side, which are edges of tint above its end.
TEST(TableCircle, ItsSideEndsByLightWhereTintsDoNotTell) {
  const PinholeView view = ViewFrom(0.3);
  Image8 picture = PictureOf(view, IsInCircle, 150, 90);
  PixelMask top{view.width, view.height, std::vector<uint8_t>(picture.pixels.size() / 3, 0)};
  PixelMask table = top;
  AddRegion({TurntableAxis(), kRadius, kTop, kTop}, view, &top);
  AddRegion({TurntableAxis(), kRadius, kSideEnd, kTop}, view, &table);
  for (int x = 0; x < kWidth; ++x) {
    const auto patch = static_cast<uint64_t>(x) / 9;
    const auto rows_above = static_cast<int>(RandomBits(19, patch, 0).words[0] % 4);
    int row = 0;
    for (int y = 0; y < kHeight; ++y) {
      const size_t i = static_cast<size_t>(y) * kWidth + x;
      if (table.inside[i] == 0 || top.inside[i] != 0) continue;
      if (++row > 2 * (1 + rows_above)) picture.pixels[3 * i + 2] += 2;
    }
  }
  const std::optional<TableCircle> circle = FindTableCircle({{view, picture}}, SearchAboutTop());
  ASSERT_TRUE(circle);
  ASSERT_TRUE(circle->side_end);
  EXPECT_NEAR(*circle->side_end, kSideEnd, 1.5 * kPixel);
}

// Two other cameras see ground of the side's own grey all around the table.
TEST(TableCircle, ItsSideEndsWhereOneCameraSeesIt) {
  std::vector<StillPicture> pictures;
  for (const double azimuth : {0.3, 1.9, 3.6}) {
    const PinholeView view = ViewFrom(azimuth);
    const auto ground = [&](const Eigen::Vector3d& x) { return azimuth < 1 ? TileAt(x) : 90; };
    pictures.push_back({view, PictureOf(view, IsInCircle, 150, 90, ground)});
  }
  const std::optional<TableCircle> circle = FindTableCircle(pictures, SearchAboutTop());
  ASSERT_TRUE(circle);
  ASSERT_TRUE(circle->side_end);
  EXPECT_NEAR(*circle->side_end, kSideEnd, 1.5 * kPixel);
  pictures.erase(pictures.begin());
  const std::optional<TableCircle> none = FindTableCircle(pictures, SearchAboutTop());
  ASSERT_TRUE(none);
  EXPECT_FALSE(none->side_end);
}

TEST(TableCircle, IsFoundByTwoCamerasAboutAnotherAxisInAnotherUnit) {
  constexpr double kScale = 0.25;
  const Rigid3 moved{Eigen::Quaterniond(Eigen::AngleAxisd(1.1, Eigen::Vector3d(1, 2, -1).normalized())),
                     {0.3, -0.2, 0.1}};
  std::vector<StillPicture> pictures;
  for (const double azimuth : {0.3, 1.9}) {
    PinholeView view = ViewFrom(azimuth);
    const Image8 image = PictureOf(view, IsInCircle, 150, 90);
    view.cam_from_world.translation *= kScale;
    view.cam_from_world = view.cam_from_world * moved.Inverse();
    pictures.push_back({view, image});
  }
  CircleSearch search = SearchAboutTop();
  search.axis.point = moved.translation;
  search.axis.direction = moved.rotation * Eigen::Vector3d::UnitZ();
  for (double* length : {&search.low, &search.high, &search.max_radius}) *length *= kScale;
  const std::optional<TableCircle> circle = FindTableCircle(pictures, search);
  ASSERT_TRUE(circle);
  EXPECT_NEAR(circle->height, kScale * kTop, kScale * kPixel);
  EXPECT_NEAR(circle->radius, kScale * kRadius, kScale * kPixel);
}

TEST(TableCircle, NoneOfWhatIsNoCircleAboutTheAxis) {
  const PinholeView view = ViewFrom(0.3);
  const Outline square = [](double x, double y) { return std::max(std::abs(x), std::abs(y)) < kRadius; };
  const Outline aside = [](double x, double y) { return std::hypot(x - 0.2, y) < kRadius; };
  const Outline nothing = [](double, double) { return false; };
  for (const Outline& outline : {square, aside, nothing}) {
    EXPECT_FALSE(FindTableCircle({{view, PictureOf(view, outline, 150, 90)}}, SearchAboutTop()));
  }
}

TEST(TableCircle, OfSeveralTheOutermost) {
  const PinholeView view = ViewFrom(0.3);
  Image8 picture = PictureOf(view, IsInCircle, 150, 90);
  // A round mat on the table.
  PixelMask mat{view.width, view.height, std::vector<uint8_t>(picture.pixels.size() / 3, 0)};
  AddRegion({TurntableAxis(), kRadius / 2, kTop, kTop}, view, &mat);
  for (size_t i = 0; i < picture.pixels.size(); ++i) {
    if (mat.inside[i / 3] != 0) picture.pixels[i] = 230;
  }
  const std::optional<TableCircle> circle = FindTableCircle({{view, picture}}, SearchAboutTop());
  ASSERT_TRUE(circle);
  EXPECT_NEAR(circle->radius, kRadius, kPixel);
}

TEST(TableCircle, NothingFromNothing) { EXPECT_FALSE(FindTableCircle({}, SearchAboutTop())); }

}  // namespace
}  // namespace s2gs
