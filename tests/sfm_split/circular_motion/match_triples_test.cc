#include "sfm_split/circular_motion/match_triples.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <random>
#include <vector>

namespace s2gs {
namespace {

// Five photos of one station with three keypoints each; keypoint 1 is matched all around but between photos 4
// and 0, keypoint 2 from photo 0 to 1 only. One pair is given from its second photo to its first.
ScanFeatures Chained(bool with_seam) {
  ScanFeatures features;
  for (int i = 0; i < 5; ++i) {
    ScanImage image;
    image.station = 0;
    for (int k = 0; k < 3; ++k)
      image.keypoints.emplace_back(static_cast<float>(20 * k + 3 * i), static_cast<float>(10 * i));
    image.labels.assign(3, KeypointLabel::kUnknown);
    features.images.push_back(image);
  }
  features.object_pairs = {{0, 1, {{1, 1}, {2, 2}}}, {2, 1, {{1, 1}}}, {2, 3, {{1, 1}}}, {3, 4, {{1, 1}}}};
  if (with_seam) features.object_pairs.push_back({0, 4, {{1, 1}}});
  return features;
}

TEST(PhotoTriples, AreOfPhotosInARowAndAcrossTheEnd) {
  const std::vector<PhotoTriple> open = PhotoTriples(Chained(false));
  ASSERT_EQ(open.size(), 3U);
  for (size_t t = 0; t < 3; ++t) {
    const int first = static_cast<int>(t);
    EXPECT_EQ(open[t].images, (std::array<int, 3>{first, first + 1, first + 2}));
    ASSERT_EQ(open[t].matches.size(), 1U);
    EXPECT_EQ(open[t].matches[0].point2D_idx, (std::array<uint32_t, 3>{1, 1, 1}));
  }
  const std::vector<PhotoTriple> closed = PhotoTriples(Chained(true));
  ASSERT_EQ(closed.size(), 5U);
  EXPECT_EQ(closed[3].images, (std::array<int, 3>{3, 4, 0}));
  EXPECT_EQ(closed[4].places, (std::array<int, 3>{4, 0, 1}));
}

TEST(PhotoTriples, AreOfOneStation) {
  ScanFeatures features = Chained(true);
  features.images[4].station = 1;
  const std::vector<PhotoTriple> triples = PhotoTriples(features);
  ASSERT_EQ(triples.size(), 2U);
  EXPECT_EQ(triples[1].images, (std::array<int, 3>{1, 2, 3}));
}

TEST(MiddleOf, IsAlongTheMove) {
  const MiddleMove middle =
      MiddleOf({Eigen::Vector2d(0, 0), Eigen::Vector2d(7, 100), Eigen::Vector2d(10, 0)});
  EXPECT_NEAR(middle.move_px, 10, 1e-12);
  EXPECT_NEAR(middle.off_px, 2, 1e-12);
}

// Half of them stand still or slide evenly, and lie half-way to .3 px; the others anywhere within 10 px.
TEST(WrongMiddles, WhatSlidesEvenlyIsWhatChanceGives) {
  std::mt19937 random(1);
  std::normal_distribution<double> even(0, 0.3);
  std::uniform_real_distribution<double> anywhere(-10, 10);
  std::vector<MiddleMove> middles;
  for (int k = 0; k < 2000; ++k) middles.push_back({20, k % 2 == 0 ? even(random) : anywhere(random)});
  const WrongMiddles wrong(middles);
  // .2 of 1 / 20, and .8 of half a normal distribution, whose peak the least width of 1.3 px (4.2 of its
  // standard deviations) flattens, beside half of 1 / 20; measured .338 and .029.
  EXPECT_GT(wrong.Chance({20, 0}), 0.2);
  EXPECT_LT(wrong.Chance({20, 0}), 0.6);
  EXPECT_NEAR(wrong.Chance({20, 5}), 0.2 / 20 + 0.8 * 0.5 / 20, 0.012);
}

TEST(WrongMiddles, OfAFewIsEvenAlongTheMove) {
  EXPECT_NEAR(WrongMiddles({{20, 0}, {20, 1}}).Chance({25, 3}), 1.0 / 25, 1e-12);
}

}  // namespace
}  // namespace s2gs
