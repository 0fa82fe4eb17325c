#include "s2gs/scene/photo_exposure.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <vector>

#include "s2gs/core/rng.h"

namespace s2gs {
namespace {

constexpr int kWidth = 64;
constexpr int kHeight = 48;

// Grey values of a room, or of a thing that looks different in each photo.
int ValueAt(uint64_t what, int x, int y, int channel) {
  const auto at = static_cast<uint64_t>(((y / 4) * kWidth + x / 4) * 3 + channel);
  return static_cast<int>(60 + 80 * UnitFloat(RandomBits(what, at, 0).words[0]));
}

// What photo i takes its channels times.
std::array<double, 3> GainsOf(int i) {
  return {std::pow(1.5, std::sin(i)), std::pow(1.5, std::sin(i + 0.4)), std::pow(1.4, std::sin(i - 0.3))};
}

// A room, before whose left share something turns. \param changes  of exposure.
std::vector<ScenePhoto> Photos(int count, double share, bool changes) {
  std::vector<ScenePhoto> photos(static_cast<size_t>(count));
  for (int i = 0; i < count; ++i) {
    ScenePhoto& photo = photos[static_cast<size_t>(i)];
    photo.image = {kWidth, kHeight, 3, std::vector<uint8_t>(size_t{kWidth} * kHeight * 3)};
    const std::array<double, 3> gains = changes ? GainsOf(i) : std::array<double, 3>{1, 1, 1};
    for (int y = 0; y < kHeight; ++y) {
      for (int x = 0; x < kWidth; ++x) {
        for (int c = 0; c < 3; ++c) {
          const uint64_t what = x < share * kWidth ? 100 + static_cast<uint64_t>(i) : 1;
          photo.image.Pixel(x, y)[c] =
              static_cast<uint8_t>(std::lround(ValueAt(what, x, y, c) * gains[static_cast<size_t>(c)]));
        }
      }
    }
  }
  return photos;
}

TEST(PhotoExposure, PhotosOfOneCameraBecomeAlike) {
  constexpr int kCount = 12;
  std::vector<ScenePhoto> photos = Photos(kCount, 0.3, true);
  const ExposureSpread spread = EqualiseExposure(&photos);
  EXPECT_EQ(spread.num_photos, kCount);
  std::array<double, 3> mean = {};
  for (int i = 0; i < kCount; ++i) {
    for (size_t c = 0; c < 3; ++c) mean[c] += std::log(GainsOf(i)[c]) / kCount;
  }
  double greatest = 1;
  double most = 0;
  for (int i = 0; i < kCount; ++i) {
    for (size_t c = 0; c < 3; ++c) greatest = std::max(greatest, GainsOf(i)[c] / std::exp(mean[c]));
    for (int x = kWidth / 2; x < kWidth; ++x) {
      for (int c = 0; c < 3; ++c) {
        const double expected = ValueAt(1, x, 20, c) * std::exp(mean[static_cast<size_t>(c)]);
        most = std::max(most, std::abs(photos[static_cast<size_t>(i)].image.Pixel(x, 20)[c] - expected));
      }
    }
  }
  EXPECT_NEAR(spread.greatest, greatest, 0.01 * greatest);
  // Of grey levels that were rounded twice, the first time where they were half as large.
  EXPECT_LT(most, 2.5);
}

// Half a per cent: grey values are whole numbers.
TEST(PhotoExposure, GainsAreToldOfPhotosAndOfTheirSmallPictures) {
  constexpr int kCount = 12;
  std::vector<ScenePhoto> photos = Photos(kCount, 0.3, true);
  std::vector<Image8> pictures;
  std::vector<const Image8*> of_photos;
  std::vector<const Image8*> of_pictures;
  for (const ScenePhoto& photo : photos) pictures.push_back(ExposurePicture(photo.image));
  for (size_t i = 0; i < photos.size(); ++i) {
    of_photos.push_back(&photos[i].image);
    of_pictures.push_back(&pictures[i]);
  }
  const std::vector<std::array<double, 3>> gains = LogExposureGains(of_photos);
  ASSERT_EQ(gains.size(), photos.size());
  EXPECT_EQ(gains, LogExposureGains(of_pictures));
  for (size_t i = 1; i < gains.size(); ++i) {
    for (size_t c = 0; c < 3; ++c) {
      const double expected = std::log(GainsOf(static_cast<int>(i))[c] / GainsOf(0)[c]);
      EXPECT_NEAR(gains[i][c] - gains[0][c], expected, 0.005) << i;
    }
  }
  EXPECT_TRUE(LogExposureGains({of_photos.begin(), of_photos.begin() + 7}).empty());
}

TEST(PhotoExposure, WhatDoesNotTellStaysAsItIs) {
  struct Case {
    const char* why;
    std::vector<ScenePhoto> photos;
  };
  for (const Case& of : {Case{"they agree", Photos(12, 0.3, false)}, Case{"too few", Photos(7, 0.3, true)},
                         Case{"most of the picture turns", Photos(12, 0.8, true)}}) {
    std::vector<ScenePhoto> photos = of.photos;
    EXPECT_EQ(EqualiseExposure(&photos).num_photos, 0) << of.why;
    for (size_t i = 0; i < photos.size(); ++i)
      EXPECT_EQ(photos[i].image.pixels, of.photos[i].image.pixels) << of.why;
  }
}

}  // namespace
}  // namespace s2gs
