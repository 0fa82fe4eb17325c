#include "sfm_split/matching/photo_order.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <numeric>
#include <random>
#include <vector>

namespace s2gs {
namespace {

constexpr int kPhotos = 24;

// Places in the turn of photos that were named at random.
std::vector<int> RandomPlaces(uint32_t seed) {
  std::vector<int> places(kPhotos);
  std::iota(places.begin(), places.end(), 0);
  std::shuffle(places.begin(), places.end(), std::mt19937(seed));
  return places;
}

// Matches that fall off with the angle, with Poisson noise and a few by chance.
SimilarityMatrix Similarity(const std::vector<int>& places, bool full_turn, double matches, uint32_t seed) {
  std::mt19937 random(seed);
  SimilarityMatrix similarity = SimilarityMatrix::Zero(kPhotos, kPhotos);
  for (int i = 0; i < kPhotos; ++i) {
    for (int j = 0; j < i; ++j) {
      int apart = std::abs(places[i] - places[j]);
      if (full_turn) apart = std::min(apart, kPhotos - apart);
      std::poisson_distribution<uint32_t> count(1 + matches * std::exp(-apart / 2.0));
      similarity(i, j) = similarity(j, i) = count(random);
    }
  }
  return similarity;
}

// Largest number of steps between photos that follow each other in the order.
int LargestStep(const std::vector<uint32_t>& order, const std::vector<int>& places, bool full_turn) {
  int largest = 0;
  for (size_t k = 0; k + 1 < order.size(); ++k) {
    int apart = std::abs(places[order[k]] - places[order[k + 1]]);
    if (full_turn) apart = std::min(apart, kPhotos - apart);
    largest = std::max(largest, apart);
  }
  return largest;
}

TEST(OrderBySimilarity, FindsAFullTurn) {
  for (uint32_t seed = 1; seed <= 20; ++seed) {
    const std::vector<int> places = RandomPlaces(seed);
    const auto order = OrderBySimilarity(Similarity(places, true, 100, seed));
    ASSERT_EQ(order.size(), places.size());
    EXPECT_EQ(order.front(), 0U);
    // Neighbours have 60 matches in common, next neighbours 37: noise swaps two now and then.
    EXPECT_LE(LargestStep(order, places, true), 2) << "seed " << seed;
  }
}

TEST(OrderBySimilarity, FindsAPartOfATurn) {
  for (uint32_t seed = 1; seed <= 20; ++seed) {
    const std::vector<int> places = RandomPlaces(seed);
    auto order = OrderBySimilarity(Similarity(places, false, 100, seed));
    // It begins anywhere: the largest step leads from one end to the other.
    size_t widest = 0;
    const auto step = [&](size_t k) {
      return std::abs(places[order[k]] - places[order[(k + 1) % order.size()]]);
    };
    for (size_t k = 0; k < order.size(); ++k) {
      if (step(k) > step(widest)) widest = k;
    }
    std::rotate(order.begin(), order.begin() + static_cast<std::ptrdiff_t>((widest + 1) % order.size()),
                order.end());
    EXPECT_LE(LargestStep(order, places, false), 2) << "seed " << seed;
  }
}

TEST(OrderBySimilarity, KeepsEveryPhotoWhereNothingIsInCommon) {
  auto order = OrderBySimilarity(SimilarityMatrix::Zero(kPhotos, kPhotos));
  std::sort(order.begin(), order.end());
  for (uint32_t i = 0; i < kPhotos; ++i) EXPECT_EQ(order[i], i);
  EXPECT_TRUE(OrderBySimilarity(SimilarityMatrix::Zero(0, 0)).empty());
  EXPECT_EQ(OrderBySimilarity(SimilarityMatrix::Zero(1, 1)).size(), 1U);
}

}  // namespace
}  // namespace s2gs
