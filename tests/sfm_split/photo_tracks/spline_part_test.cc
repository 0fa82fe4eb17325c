#include "sfm_split/photo_tracks/spline_part.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace s2gs {
namespace {

PhotoPart Part(int x, int y, int width, int height, double (*of)(double, double)) {
  PhotoPart part{x, y, width, height, {}};
  for (int j = 0; j < height; ++j) {
    for (int i = 0; i < width; ++i)
      part.grey.push_back(static_cast<uint8_t>(std::lround(of(x + i + 0.5, y + j + 0.5))));
  }
  return part;
}

TEST(SplinePart, GoesThroughThePixels) {
  std::mt19937 random(3);
  PhotoPart part{10, 20, 13, 9, {}};
  for (int i = 0; i < 13 * 9; ++i) part.grey.push_back(static_cast<uint8_t>(random() & 255));
  const SplinePart spline(part);
  for (int j = 1; j < 7; ++j) {
    for (int i = 1; i < 11; ++i)
      EXPECT_NEAR(spline.Value(10.5 + i, 20.5 + j), part.grey[static_cast<size_t>(j * 13 + i)], 1e-3);
  }
}

TEST(SplinePart, IsLinearBetweenPixelsOfARamp) {
  const SplinePart spline(
      Part(100, 50, 24, 24, [](double x, double y) { return 4 * (x - 99.5) + 2 * (y - 49.5) + 3; }));
  for (double y = 60; y < 64; y += 0.37) {
    for (double x = 108; x < 114; x += 0.29)
      EXPECT_NEAR(spline.Value(x, y), 4 * (x - 99.5) + 2 * (y - 49.5) + 3, 1e-3);
  }
}

// Between pixels of a wave of 6 px: within the pixels' rounding (largest 0.94 measured), where a straight
// line between neighbours is 8 off.
TEST(SplinePart, FollowsAWave) {
  const auto wave = [](double x, double y) { return 128 + 60 * std::sin(x * 1.047) * std::cos(y * 0.6); };
  const SplinePart spline(Part(0, 0, 40, 40, wave));
  for (double y = 10; y < 30; y += 0.31) {
    for (double x = 10; x < 30; x += 0.37) EXPECT_NEAR(spline.Value(x, y), wave(x, y), 1.5);
  }
}

TEST(SplinePart, ContainsWhereSixteenPixelsAreThere) {
  const SplinePart spline(Part(5, 7, 4, 6, [](double, double) { return 1.0; }));
  EXPECT_TRUE(spline.Contains(6.5, 8.5));
  EXPECT_TRUE(spline.Contains(7.49, 10.49));
  EXPECT_FALSE(spline.Contains(6.49, 8.5));
  EXPECT_FALSE(spline.Contains(7.5, 8.5));
  EXPECT_FALSE(spline.Contains(6.5, 11.5));
  EXPECT_FALSE(spline.Contains(-1e9, 8.5));
  EXPECT_FALSE(spline.Contains(6.5, std::nan("")));
}

}  // namespace
}  // namespace s2gs
