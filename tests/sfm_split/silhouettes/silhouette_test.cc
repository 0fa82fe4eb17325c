#include "sfm_split/silhouettes/silhouette.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "sfm_split/base/angles.h"

namespace s2gs {
namespace {

constexpr int kWidth = 200;
constexpr int kHeight = 150;
constexpr int kPhotos = 16;

// What stands still: squares of 6 px of random shades.
double Background(int x, int y) {
  const auto cell = static_cast<uint32_t>(x / 6 * 131 + y / 6);
  return 60 + static_cast<double>((cell * 2654435761U) >> 24) / 2;
}

// An ellipse that turns about its lower end, and its shadow to the right.
struct Moving {
  double x = 0;
  double half_width = 0;

  explicit Moving(int photo) {
    const double angle = 2 * kPi * photo / kPhotos;
    x = 90 + 30 * std::cos(angle);
    half_width = 18 + 3 * std::sin(angle);
  }
  bool Hides(double px, double py) const {
    return std::pow((px - x) / half_width, 2) + std::pow((py - 70) / 40, 2) < 1;
  }
  bool Shades(double px, double py) const {
    return std::pow((px - x - half_width - 14) / 16, 2) + std::pow((py - 95) / 9, 2) < 1;
  }
};

bool IsPasser(int photo, int x, int y) { return photo == 5 && x > 180 && x < 197 && y > 20 && y < 120; }

std::vector<GreyPicture> Pictures() {
  std::mt19937 random(3);
  std::normal_distribution<double> noise(0, 1.5);
  std::vector<GreyPicture> pictures;
  for (int k = 0; k < kPhotos; ++k) {
    const Moving thing(k);
    GreyPicture picture;
    picture.photo_size = {2 * kWidth, 2 * kHeight};
    picture.width = kWidth;
    picture.height = kHeight;
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        double grey = Background(x, y) * (thing.Shades(x, y) ? 0.6 : 1);
        if (thing.Hides(x, y)) grey = 120 + 40 * std::sin(0.3 * (x - thing.x) + 0.2 * y + k);
        if (IsPasser(k, x, y)) grey = 20;
        picture.grey.push_back(static_cast<uint8_t>(std::clamp(std::lround(grey + noise(random)), 0L, 255L)));
      }
    }
    pictures.push_back(std::move(picture));
  }
  return pictures;
}

TEST(Silhouette, OutlinesWhatTurnsAndNeitherShadowsNorPassersBy) {
  const std::vector<Silhouette> silhouettes = FindSilhouettes(Pictures(), 60);
  ASSERT_EQ(silhouettes.size(), kPhotos);
  for (int k = 0; k < kPhotos; ++k) {
    const Silhouette& silhouette = silhouettes[static_cast<size_t>(k)];
    ASSERT_TRUE(silhouette.IsFound());
    const Moving thing(k);
    int missed = 0;
    int hidden = 0;
    int beside = 0;
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        const bool inside = silhouette.inside[static_cast<size_t>(y) * kWidth + x] > 0;
        hidden += thing.Hides(x, y) ? 1 : 0;
        missed += thing.Hides(x, y) && !inside ? 1 : 0;
        beside += inside && x > 175 ? 1 : 0;
      }
    }
    // 0 to .9 % measured: of the thing's pixels that look like what they hide.
    EXPECT_LT(missed, 0.02 * hidden) << k;
    EXPECT_EQ(beside, 0) << k;
    // Places are of the photo, twice the picture.
    ASSERT_GT(silhouette.rim.size(), 20U);
    int off = 0;
    int on_shadow = 0;
    for (const Eigen::Vector2d& xy : silhouette.rim) {
      const double x = xy.x() / 2 - 0.5;
      const double y = xy.y() / 2 - 0.5;
      const double r = std::sqrt(std::pow((x - thing.x) / thing.half_width, 2) + std::pow((y - 70) / 40, 2));
      if (std::abs(r - 1) * thing.half_width < 3.5) continue;
      ++off;
      on_shadow += thing.Shades(x, y) ? 1 : 0;
    }
    // Up to 38 % measured: where the thing and its shadow stand before a place in most photos, these pass for
    // what stands still, and photos that show what is behind seem to change.
    EXPECT_LT(off, 0.5 * static_cast<double>(silhouette.rim.size())) << k;
    // 0 to 6 of 113 measured.
    EXPECT_LE(on_shadow, 0.1 * static_cast<double>(silhouette.rim.size())) << k;
  }
}

TEST(Silhouette, SaysHowFarAPlaceLiesOutside) {
  Silhouette silhouette;
  silhouette.width = 20;
  silhouette.height = 10;
  silhouette.photo_px = {3, 3};
  for (int y = 0; y < 10; ++y) {
    for (int x = 0; x < 20; ++x)
      silhouette.inside.push_back(
          std::clamp(static_cast<float>(x) - 8.0F, -Silhouette::kReachPx, Silhouette::kReachPx));
  }
  // The centre of column 6 is 19.5 px of the photo from its left.
  EXPECT_FLOAT_EQ(silhouette.Outside({19.5, 15}), 2);
  EXPECT_FLOAT_EQ(silhouette.Outside({18, 15}), 2.5);
  EXPECT_FLOAT_EQ(silhouette.Outside({30, 15}), 0);
  EXPECT_FLOAT_EQ(silhouette.Outside({3, 15}), Silhouette::kReachPx);
  EXPECT_FLOAT_EQ(silhouette.Outside({-3, 15}), 0) << "nothing is known beyond the picture";
}

TEST(Silhouette, FindsNothingWhereNothingChanges) {
  std::vector<GreyPicture> pictures = Pictures();
  for (GreyPicture& picture : pictures) picture.grey = pictures.front().grey;
  for (const Silhouette& silhouette : FindSilhouettes(pictures, 60)) EXPECT_FALSE(silhouette.IsFound());
}

}  // namespace
}  // namespace s2gs
