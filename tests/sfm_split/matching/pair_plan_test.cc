#include "sfm_split/matching/pair_plan.h"

#include <gmock/gmock.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <random>
#include <set>
#include <string>
#include <vector>

namespace s2gs {

void PrintTo(ImagePair pair, std::ostream* out) { *out << pair.first << "-" << pair.second; }

namespace {

using ::testing::ElementsAre;
using ::testing::IsEmpty;
using Pairs = std::vector<ImagePair>;

std::vector<uint32_t> Range(size_t num) {
  std::vector<uint32_t> range(num);
  std::iota(range.begin(), range.end(), 0U);
  return range;
}

std::vector<uint32_t> Shuffled(size_t num, uint32_t seed) {
  std::vector<uint32_t> order = Range(num);
  std::shuffle(order.begin(), order.end(), std::mt19937(seed));
  return order;
}

void ExpectWellFormed(const Pairs& pairs, size_t num_images) {
  for (size_t i = 0; i < pairs.size(); ++i) {
    EXPECT_LT(pairs[i].first, pairs[i].second);
    EXPECT_LT(pairs[i].second, num_images);
    if (i > 0) {
      EXPECT_TRUE(pairs[i - 1] < pairs[i]);
    }
  }
}

size_t NumComponents(const Pairs& pairs, size_t num_images) {
  std::vector<uint32_t> label = Range(num_images);
  for (bool changed = true; changed;) {
    changed = false;
    for (const ImagePair pair : pairs) {
      const uint32_t low = std::min(label[pair.first], label[pair.second]);
      changed |= label[pair.first] != low || label[pair.second] != low;
      label[pair.first] = label[pair.second] = low;
    }
  }
  return std::set<uint32_t>(label.begin(), label.end()).size();
}

TEST(PairPlan, NewPairsAreSortedUniqueAndNotDone) {
  const Pairs pairs = {{3, 4}, {0, 1}, {3, 4}, {0, 2}, {1, 2}};
  EXPECT_EQ(NewPairs(pairs, {{5, 6}, {1, 2}}), (Pairs{{0, 1}, {0, 2}, {3, 4}}));
  EXPECT_EQ(NewPairs({}, pairs), Pairs{});
}

TEST(PairPlan, NaturalNameOrder) {
  const std::vector<std::string> names = {"img10.jpg",  "img2.jpg",  "img1.jpg",
                                          "b/img1.jpg", "img02.jpg", "img2_b.jpg",
                                          "img",        "IMG_3",     "img99999999999999999999999"};
  std::vector<std::string> sorted;
  for (const uint32_t i : NaturalNameOrder(names)) sorted.push_back(names[i]);
  EXPECT_THAT(sorted, ElementsAre("IMG_3", "b/img1.jpg", "img", "img1.jpg", "img02.jpg", "img2.jpg",
                                  "img2_b.jpg", "img10.jpg", "img99999999999999999999999"));
}

TEST(PairPlan, NeighboursInOrder) {
  EXPECT_EQ(NeighbourPairs({2, 0, 3, 1}, 1, false), (Pairs{{0, 2}, {0, 3}, {1, 3}}));
  EXPECT_EQ(NeighbourPairs({2, 0, 3, 1}, 1, true), (Pairs{{0, 2}, {0, 3}, {1, 2}, {1, 3}}));
  EXPECT_THAT(NeighbourPairs({}, 2, true), IsEmpty());
  EXPECT_THAT(NeighbourPairs({0}, 2, true), IsEmpty());
  EXPECT_EQ(NeighbourPairs({0, 1}, 5, true), (Pairs{{0, 1}}));
  EXPECT_EQ(NeighbourPairs(Range(4), 9, true).size(), 6U);  // no more than all pairs
}

TEST(PairPlan, NeighboursGrowLinearlyAndConnect) {
  for (const size_t num : {50U, 100U, 200U}) {
    const Pairs pairs = NeighbourPairs(Shuffled(num, 1), 3, true);
    ExpectWellFormed(pairs, num);
    EXPECT_EQ(pairs.size(), 3 * num);
    EXPECT_EQ(NumComponents(pairs, num), 1U);
  }
}

// Similarity that falls with the distance on a line, the images shuffled.
SimilarityMatrix LineSimilarity(const std::vector<uint32_t>& order) {
  const auto num = static_cast<int>(order.size());
  SimilarityMatrix similarity(num, num);
  for (int i = 0; i < num; ++i) {
    for (int j = 0; j < num; ++j) similarity(order[i], order[j]) = 2U * (num - std::abs(i - j));
  }
  return similarity;
}

TEST(PairPlan, OrderAgreementTellsCaptureOrderFromRandomOrder) {
  const std::vector<uint32_t> order = Shuffled(60, 2);
  const SimilarityMatrix similarity = LineSimilarity(order);
  // Ties of the two neighbours cost half a place of 58.
  EXPECT_NEAR(OrderAgreement(order, similarity), 1.0, 0.01);
  double sum = 0.0;
  for (uint32_t seed = 10; seed < 30; ++seed) sum += OrderAgreement(Shuffled(60, seed), similarity);
  EXPECT_NEAR(sum / 20.0, 2.0 / 3.0, 0.03);  // mean of the maximum of two uniform numbers
  EXPECT_LT(OrderAgreement(Shuffled(60, 10), similarity), kMinOrderAgreement);
  EXPECT_NEAR(OrderAgreement(order, SimilarityMatrix::Constant(60, 60, 5)), 0.5, 1e-12);
}

TEST(PairPlan, SimilarPairsFindNeighboursOfUnorderedImages) {
  const std::vector<uint32_t> order = Shuffled(80, 3);
  const Pairs pairs = SimilarPairs(LineSimilarity(order), 4);
  ExpectWellFormed(pairs, 80);
  for (const ImagePair neighbours : NeighbourPairs(order, 2, false)) {
    EXPECT_TRUE(std::binary_search(pairs.begin(), pairs.end(), neighbours));
  }
  EXPECT_LE(pairs.size(), 80U * 4U);
}

TEST(PairPlan, SimilarPairsConnectGroups) {
  // Two groups of ten, alike inside; only the pairs 3-15 and 4-16 hold them together, the former better.
  SimilarityMatrix similarity = SimilarityMatrix::Zero(21, 21);
  for (int i = 0; i < 20; ++i) {
    for (int j = 0; j < 20; ++j) similarity(i, j) = i / 10 == j / 10 ? 100 : 0;
  }
  similarity(3, 15) = similarity(15, 3) = 2;
  similarity(4, 16) = similarity(16, 4) = 1;
  const Pairs pairs = SimilarPairs(similarity, 3);
  ExpectWellFormed(pairs, 21);
  EXPECT_EQ(NumComponents(pairs, 21), 2U);  // the last image is similar to none
  EXPECT_TRUE(std::binary_search(pairs.begin(), pairs.end(), ImagePair{3, 15}));
  EXPECT_FALSE(std::binary_search(pairs.begin(), pairs.end(), ImagePair{4, 16}));
  EXPECT_THAT(SimilarPairs(SimilarityMatrix(0, 0), 3), IsEmpty());
}

TEST(PairPlan, RepresentativesHaveMostFeatures) {
  EXPECT_THAT(StationRepresentatives({1, 0, 1, 0, -1, 1}, {5, 7, 9, 7, 100, 9}), ElementsAre(1, 2));
  EXPECT_THAT(StationRepresentatives({}, {}), IsEmpty());
}

TEST(PairPlan, RepresentativePairsAreAllOfFewAndLinearInMany) {
  EXPECT_EQ(RepresentativePairs({4, 9, 1}, 10), (Pairs{{1, 4}, {1, 9}, {4, 9}}));
  EXPECT_EQ(RepresentativePairs(Range(11), 10).size(), 55U);
  for (const size_t num : {100U, 200U, 400U}) {
    const Pairs pairs = RepresentativePairs(Shuffled(num, 5), 6);
    ExpectWellFormed(pairs, num);
    EXPECT_EQ(NumComponents(pairs, num), 1U);
    EXPECT_LE(pairs.size(), 6 * num);
  }
}

}  // namespace
}  // namespace s2gs
