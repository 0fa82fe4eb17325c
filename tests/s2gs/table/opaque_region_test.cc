#include "s2gs/table/opaque_region.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <optional>
#include <vector>

#include "tests/support/view_from_above.h"

namespace s2gs {
namespace {

constexpr int kWidth = 240;
constexpr int kHeight = 180;
constexpr double kDistance = 5;
constexpr size_t kNumPixels = size_t{kWidth} * kHeight;
const RotatingRegion kRegion{TurntableAxis(), 1, -0.15, 0.1};

PinholeView View() { return ViewFromAbove(kWidth, kHeight, 260, 0.3, kDistance); }

Eigen::Vector3d RayOf(const PinholeView& view, int x, int y) {
  return view.cam_from_world.Inverse().rotation *
         Eigen::Vector3d((x + 0.5 - view.cx) / view.fx, (y + 0.5 - view.cy) / view.fy, 1);
}

// Against rays that march through the cylinder.
TEST(AddRegion, IsWhereRaysMeetTheCylinder) {
  const PinholeView view = View();
  PixelMask mask{kWidth, kHeight, std::vector<uint8_t>(kNumPixels, 0)};
  AddRegion(kRegion, view, &mask);
  const Eigen::Vector3d eye = view.cam_from_world.Inverse().translation;
  int differ = 0;
  int inside = 0;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      bool meets = false;
      for (double depth = 3; depth < 8 && !meets; depth += 0.005)
        meets = kRegion.Contains(eye + depth * RayOf(view, x, y), 0);
      const bool has = mask.inside[static_cast<size_t>(y) * kWidth + x] != 0;
      inside += has ? 1 : 0;
      differ += has != meets ? 1 : 0;
    }
  }
  EXPECT_GT(inside, 5000);
  EXPECT_LT(differ, 20);  // steps miss where a ray grazes an edge
}

TEST(RegionView, HitsLieOnTheSurfaceAndNormalsPointOutwards) {
  const PinholeView view = View();
  const RegionView seen(kRegion, view);
  const Rigid3 world_from_cam = view.cam_from_world.Inverse();
  int on_top = 0;
  int on_side = 0;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const std::optional<RegionHit> hit = seen.At(x, y);
      if (!hit) continue;
      const Eigen::Vector3d place = world_from_cam.translation + hit->depth * RayOf(view, x, y);
      const Eigen::Vector3d normal = world_from_cam.rotation * hit->normal;
      if (std::abs(place.z() - kRegion.high) < 1e-9) {
        ++on_top;
        EXPECT_NEAR(normal.z(), 1, 1e-9);
        EXPECT_LE(place.head<2>().norm(), kRegion.radius + 1e-9);
      } else {
        ++on_side;
        EXPECT_NEAR(place.head<2>().norm(), kRegion.radius, 1e-9);
        EXPECT_NEAR((normal - Eigen::Vector3d(place.x(), place.y(), 0)).norm(), 0, 1e-9);
      }
    }
  }
  EXPECT_GT(on_top, 4000);
  EXPECT_GT(on_side, 300);
}

RenderedView Rendered(float alpha, float depth) {
  RenderedView rendered;
  rendered.width = kWidth;
  rendered.height = kHeight;
  rendered.alpha.assign(kNumPixels, alpha);
  rendered.median_depth.assign(kNumPixels, depth);
  rendered.expected_depth.assign(kNumPixels, depth);
  rendered.normal.assign(3 * kNumPixels, 0.5F);
  return rendered;
}

TEST(DrawOpaqueRegion, HidesWhatLiesBehindAndFillsWhatIsOpen) {
  const PinholeView view = View();
  const RegionView seen(kRegion, view);
  for (const RenderedView& before : {Rendered(0, 0), Rendered(1, 9), Rendered(0.3F, 1)}) {
    RenderedView after = before;
    DrawOpaqueRegion(kRegion, view, &after);
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const size_t i = static_cast<size_t>(y) * kWidth + x;
        const std::optional<RegionHit> hit = seen.At(x, y);
        const float depth = hit ? static_cast<float>(hit->depth) : before.median_depth[i];
        ASSERT_EQ(after.median_depth[i], depth);
        ASSERT_EQ(after.expected_depth[i], depth);
        ASSERT_EQ(after.alpha[i], hit ? 1 : before.alpha[i]);
      }
    }
  }
}

TEST(DrawOpaqueRegion, LeavesWhatStandsBeforeIt) {
  const RenderedView before = Rendered(0.9F, 3);
  RenderedView after = before;
  DrawOpaqueRegion(kRegion, View(), &after);
  EXPECT_EQ(after.median_depth, before.median_depth);
  EXPECT_EQ(after.alpha, before.alpha);
  EXPECT_EQ(after.normal, before.normal);
}

// Marks of half of the size on every other column.
TEST(DrawRegionWhereSeen, HidesWhatTheModelHasBeforeIt) {
  const PinholeView view = View();
  MarkedPixels seen{{kWidth / 2, kHeight / 2, 1, {}}, view};
  seen.view.width /= 2;
  seen.view.height /= 2;
  for (double* length : {&seen.view.fx, &seen.view.fy, &seen.view.cx, &seen.view.cy}) *length /= 2;
  for (size_t i = 0; i < kNumPixels / 4; ++i) seen.marks.pixels.push_back(i % 2 == 0 ? 255 : 254);
  const RegionView hits(kRegion, view);
  const RenderedView before = Rendered(0.9F, 3);
  RenderedView after = before;
  DrawRegionWhereSeen(kRegion, seen, view, &after);
  int num_drawn = 0;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const size_t i = static_cast<size_t>(y) * kWidth + x;
      const std::optional<RegionHit> hit = hits.At(x, y);
      const bool is_drawn = hit && x / 2 % 2 == 0;
      num_drawn += is_drawn ? 1 : 0;
      ASSERT_EQ(after.median_depth[i], is_drawn ? static_cast<float>(hit->depth) : 3) << x << ' ' << y;
      ASSERT_EQ(after.expected_depth[i], after.median_depth[i]);
      ASSERT_EQ(after.alpha[i], is_drawn ? 1 : 0.9F);
    }
  }
  EXPECT_GT(num_drawn, 2000);
}

// Marks of the upper half alone; what lies beyond their rows is marked in memory, and no part of them.
TEST(DrawRegionWhereSeen, LeavesOutWhatThePhotoDoesNotShow) {
  const PinholeView view = View();
  MarkedPixels seen{{kWidth, kHeight / 2, 1, std::vector<uint8_t>(kNumPixels, 255)}, view};
  seen.view.height = kHeight / 2;
  RenderedView rendered = Rendered(0, 0);
  DrawRegionWhereSeen(kRegion, seen, view, &rendered);
  const RegionView hits(kRegion, view);
  int drawn = 0;
  int left_out = 0;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const bool is_drawn = rendered.alpha[static_cast<size_t>(y) * kWidth + x] > 0;
      const bool is_hit = hits.At(x, y).has_value();
      EXPECT_EQ(is_drawn, is_hit && y < kHeight / 2) << x << ' ' << y;
      drawn += is_drawn ? 1 : 0;
      left_out += is_hit && !is_drawn ? 1 : 0;
    }
  }
  EXPECT_GT(drawn, 1000);
  EXPECT_GT(left_out, 1000);
}

}  // namespace
}  // namespace s2gs
