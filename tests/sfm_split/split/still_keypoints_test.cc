#include "sfm_split/split/still_keypoints.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <random>
#include <vector>

#include "sfm_split/base/angles.h"

namespace s2gs {
namespace {

constexpr double kUnmovedPx = 1.5;
constexpr int kPhotos = 12;

// Photos of one station without keypoints.
std::vector<SplitImage> Photos() {
  std::vector<SplitImage> images(kPhotos);
  for (SplitImage& image : images) image.size = {200, 200};
  return images;
}

Stations OneStation() {
  Stations stations;
  stations.station_of_image.assign(kPhotos, 0);
  stations.images.resize(1);
  for (int i = 0; i < kPhotos; ++i) stations.images[0].push_back(i);
  stations.shift.assign(kPhotos, Eigen::Vector2f::Zero());
  return stations;
}

// All of the same look.
void Add(const Eigen::Vector2f& xy, SplitImage* image) {
  image->keypoints.push_back(xy);
  image->descriptors.insert(image->descriptors.end(), 128, 40);
}

TEST(StillKeypoints, WhatAFewPhotosInARowShowLingers) {
  std::vector<SplitImage> images = Photos();
  for (int i = 0; i < kPhotos; ++i) {
    Add({50, 50}, &images[static_cast<size_t>(i)]);
    if (i % 2 == 0) Add({100, 50}, &images[static_cast<size_t>(i)]);
  }
  // The last photos and the first are next to each other, too.
  for (const int i : {0, 1, 2, 10}) Add({150, 50}, &images[static_cast<size_t>(i)]);
  for (const int i : {0, 2, 6, 10}) Add({50, 150}, &images[static_cast<size_t>(i)]);
  const StillSupport still = FindStillSupport(images, OneStation(), kUnmovedPx);
  EXPECT_EQ(still.num_partners[0], kPhotos - 1);
  for (const size_t i : {size_t{0}, size_t{2}, size_t{10}}) {
    EXPECT_EQ(still.support[i], (std::vector<int>{11, 5, 3, 3})) << i;
    EXPECT_EQ(still.lingers[i], (std::vector<bool>{false, false, true, false})) << i;
  }
}

// Keypoints that lie anywhere and all look alike: as many photos show one at a place by chance as the
// keypoints around it say. Both lie within 1 % of what their density makes.
TEST(StillKeypoints, ChanceIsThatOfKeypointsThatLieAnywhere) {
  std::mt19937_64 random(1);
  std::uniform_real_distribution<float> place(0, 200);
  std::vector<SplitImage> images = Photos();
  constexpr double kDensity = 0.08;
  for (SplitImage& image : images) {
    for (int k = 0; k < static_cast<int>(kDensity * 200 * 200); ++k)
      Add({place(random), place(random)}, &image);
  }
  const StillSupport still = FindStillSupport(images, OneStation(), kUnmovedPx);
  double shown = 0;
  double chance = 0;
  int inside = 0;
  for (size_t k = 0; k < images[0].keypoints.size(); ++k) {
    const Eigen::Vector2f& xy = images[0].keypoints[k];
    if (xy.minCoeff() < 10 || xy.maxCoeff() > 190) continue;
    shown += still.support[0][k] / static_cast<double>(still.num_partners[0]);
    chance += still.chance[0][k];
    ++inside;
  }
  const double expected = kDensity * kPi * kUnmovedPx * kUnmovedPx;
  EXPECT_NEAR(chance / inside, expected, 0.01 * expected);
  EXPECT_NEAR(shown / inside, 1 - std::exp(-expected), 0.01 * expected);
}

TEST(StillKeypoints, NothingLooksLikeOneThatIsAlone) {
  std::vector<SplitImage> images = Photos();
  for (SplitImage& image : images) {
    Add({50, 50}, &image);
    Add({120, 50}, &image);
  }
  const StillSupport still = FindStillSupport(images, OneStation(), kUnmovedPx);
  EXPECT_EQ(still.chance[0], (std::vector<float>{0, 0}));
  EXPECT_EQ(still.support[0], (std::vector<int>{11, 11}));
}

}  // namespace
}  // namespace s2gs
