#include "sfm_split/matching/weak_features.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

namespace s2gs {
namespace {

constexpr int kSize = 160;

struct Blobs {
  std::vector<uint8_t> grey;
  Keypoints centres;  // COLMAP's pixels
};

// Gaussian blobs of little contrast at places between pixels, on a grid, with noise.
Blobs MakeBlobs(double contrast, double noise) {
  std::mt19937 random(3);
  std::uniform_real_distribution<float> jitter(-3, 3);
  std::normal_distribution<double> gauss;
  Blobs blobs;
  for (int y = 20; y < kSize - 15; y += 20) {
    for (int x = 20; x < kSize - 15; x += 20) {
      const float dx = jitter(random);
      const float dy = jitter(random);
      blobs.centres.emplace_back(static_cast<float>(x) + dx, static_cast<float>(y) + dy);
    }
  }
  for (int y = 0; y < kSize; ++y) {
    for (int x = 0; x < kSize; ++x) {
      double value = 120 + noise * gauss(random);
      for (const Eigen::Vector2f& centre : blobs.centres) {
        const double squared = std::pow(x + 0.5 - centre.x(), 2.0) + std::pow(y + 0.5 - centre.y(), 2.0);
        value += contrast * std::exp(-squared / (2 * 2.5 * 2.5));
      }
      blobs.grey.push_back(static_cast<uint8_t>(std::clamp(std::lround(value), 0L, 255L)));
    }
  }
  return blobs;
}

// Distances of the features that lie nearest to each blob, where one lies within 2 px.
std::vector<Eigen::Vector2f> Offsets(const Blobs& blobs, const SiftFeatures& features) {
  std::vector<Eigen::Vector2f> offsets;
  for (const Eigen::Vector2f& centre : blobs.centres) {
    Eigen::Vector2f best(2, 2);
    for (const Eigen::Vector2f& xy : features.keypoints) {
      if ((xy - centre).norm() < best.norm()) best = xy - centre;
    }
    if (best.norm() < 2) offsets.push_back(best);
  }
  return offsets;
}

// The mean of n measurements of noise 1 has a variance of the inverse of the sum of n ones.
TEST(GainOfFeatures, IsThatOfTheStandardDeviationOfAMean) {
  const auto sigma = [](int num) {
    double information = 0;
    for (int i = 0; i < num; ++i) information += 1;
    return std::sqrt(1 / information);
  };
  EXPECT_NEAR(GainOfFeatures(300, 100), 1 - sigma(400) / sigma(300), 1e-15);
  EXPECT_LT(GainOfFeatures(100, 2), kLeastFeatureGain);
  EXPECT_GT(GainOfFeatures(100, 3), kLeastFeatureGain);
  EXPECT_EQ(GainOfFeatures(100, 0), 0);
  EXPECT_EQ(GainOfFeatures(0, 0), 0);
  EXPECT_EQ(GainOfFeatures(0, 5), 1);
}

TEST(FindWeakFeatures, FindsBlobsOfFewGreyLevelsWhereTheyAre) {
  const Blobs blobs = MakeBlobs(12, 0.5);
  const std::vector<uint8_t> all(blobs.grey.size(), 1);
  const SiftFeatures features = FindWeakFeatures({kSize, kSize, blobs.grey.data(), all.data()}, {}, {}, 2000);
  ASSERT_EQ(features.descriptors.size(), 128 * features.keypoints.size());
  ASSERT_EQ(features.scales.size(), features.keypoints.size());
  const std::vector<Eigen::Vector2f> offsets = Offsets(blobs, features);
  EXPECT_GE(offsets.size(), blobs.centres.size() * 9 / 10);
  Eigen::Vector2f mean = Eigen::Vector2f::Zero();
  for (const Eigen::Vector2f& offset : offsets) mean += offset / static_cast<float>(offsets.size());
  // A convention that is half a pixel or a quarter off shows here.
  EXPECT_LT(mean.norm(), 0.1F);
}

TEST(FindWeakFeatures, LeavesOutWhatIsKnownAndWhatLiesElsewhere) {
  const Blobs blobs = MakeBlobs(12, 0.5);
  std::vector<uint8_t> left(blobs.grey.size(), 0);
  for (size_t k = 0; k < left.size(); ++k) left[k] = k % kSize < kSize / 2 ? 1 : 0;
  const SiftFeatures features =
      FindWeakFeatures({kSize, kSize, blobs.grey.data(), left.data()}, {}, {}, 2000);
  ASSERT_FALSE(features.keypoints.empty());
  for (const Eigen::Vector2f& xy : features.keypoints) EXPECT_LE(xy.x(), kSize / 2 + 1);
  const SiftFeatures again = FindWeakFeatures({kSize, kSize, blobs.grey.data(), left.data()},
                                              features.keypoints, features.scales, 2000);
  EXPECT_TRUE(again.keypoints.empty());
  EXPECT_EQ(FindWeakFeatures({kSize, kSize, blobs.grey.data(), left.data()}, {}, {}, 5).keypoints.size(), 5U);
}

TEST(FindWeakFeatures, TakesNoNoiseForFeatures) {
  const Blobs blobs = MakeBlobs(0, 3);
  const std::vector<uint8_t> all(blobs.grey.size(), 1);
  const SiftFeatures features = FindWeakFeatures({kSize, kSize, blobs.grey.data(), all.data()}, {}, {}, 2000);
  // 25,600 pixels of noise have thousands of extrema.
  EXPECT_LT(features.keypoints.size(), 150U);
  const std::vector<uint8_t> none(blobs.grey.size(), 0);
  EXPECT_TRUE(
      FindWeakFeatures({kSize, kSize, blobs.grey.data(), none.data()}, {}, {}, 2000).keypoints.empty());
}

}  // namespace
}  // namespace s2gs
