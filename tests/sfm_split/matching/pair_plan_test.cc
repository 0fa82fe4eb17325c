#include "sfm_split/matching/pair_plan.h"

#include <gmock/gmock.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <random>
#include <set>
#include <string>
#include <vector>

#include "sfm_split/base/angles.h"

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

// Stations one above the other, the table turning in equal steps at each.
struct Scene {
  std::vector<int> station;
  std::vector<Eigen::Vector3d> view;
};

Scene TurntableScene(int num_stations, int num_steps) {
  Scene scene;
  for (int s = 0; s < num_stations; ++s) {
    const double elevation = 0.1 + 0.25 * s;
    for (int t = 0; t < num_steps; ++t) {
      const double azimuth = 2.0 * kPi * t / num_steps;
      scene.station.push_back(s);
      scene.view.emplace_back(3.0 * std::cos(elevation) * std::cos(azimuth),
                              3.0 * std::cos(elevation) * std::sin(azimuth), 3.0 * std::sin(elevation));
    }
  }
  return scene;
}

double AngleDeg(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return std::acos(std::clamp(a.normalized().dot(b.normalized()), -1.0, 1.0)) * 180.0 / kPi;
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

TEST(PairPlan, StationPairsByStepsWithinStations) {
  const std::vector<int> station = {0, 1, 0, 1, 0, 1, 0, -1};
  EXPECT_EQ(StationPairs(station, Range(8), 1, 1, false), (Pairs{{0, 2}, {1, 3}, {2, 4}, {3, 5}, {4, 6}}));
  EXPECT_EQ(StationPairs(station, Range(8), 1, 1, true),
            (Pairs{{0, 2}, {0, 6}, {1, 3}, {1, 5}, {2, 4}, {3, 5}, {4, 6}}));
  EXPECT_EQ(StationPairs(station, Range(8), 2, 3, false), (Pairs{{0, 4}, {0, 6}, {1, 5}, {2, 6}}));
  EXPECT_EQ(StationPairs(station, Range(8), 2, 3, true), (Pairs{{0, 4}, {2, 6}}));
}

TEST(PairPlan, StationPairsOfIncreasingRangesCoverEachPairOnce) {
  const Scene scene = TurntableScene(3, 11);
  const std::vector<uint32_t> order = Shuffled(33, 4);
  for (const bool closed : {false, true}) {
    Pairs all;
    for (const auto& [first, last] : {std::pair(1, 2), std::pair(3, 5), std::pair(6, 11)}) {
      const Pairs pairs = StationPairs(scene.station, order, first, last, closed);
      EXPECT_EQ(NewPairs(pairs, all).size(), pairs.size());
      all.insert(all.end(), pairs.begin(), pairs.end());
    }
    EXPECT_EQ(all.size(), 3U * 11 * 10 / 2);
  }
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

TEST(PairPlan, ObjectPairsSeeTheSameSide) {
  const Scene scene = TurntableScene(5, 20);
  ObjectPairOptions options;
  options.max_view_angle_deg = 50.0;
  const Pairs pairs = ObjectPairs(scene.station, scene.view, options);
  ExpectWellFormed(pairs, 100);
  EXPECT_EQ(NumComponents(pairs, 100), 1U);
  std::vector<int> degree(100);
  for (const ImagePair pair : pairs) {
    EXPECT_LE(AngleDeg(scene.view[pair.first], scene.view[pair.second]), 50.0 + 1e-9);
    ++degree[pair.first];
    ++degree[pair.second];
  }
  EXPECT_GE(*std::min_element(degree.begin(), degree.end()), 10);
  // The next step of each station, and the same angle at the next station, are the closest views of all.
  for (int s = 0; s < 5; ++s) {
    for (int t = 0; t < 20; ++t) {
      const auto image = static_cast<uint32_t>(20 * s + t);
      const auto next = static_cast<uint32_t>(20 * s + (t + 1) % 20);
      EXPECT_TRUE(std::binary_search(pairs.begin(), pairs.end(),
                                     ImagePair{std::min(image, next), std::max(image, next)}));
      if (s < 4) {
        EXPECT_TRUE(std::binary_search(pairs.begin(), pairs.end(), ImagePair{image, image + 20}));
      }
    }
  }
}

TEST(PairPlan, ObjectPairsGrowLinearly) {
  ObjectPairOptions options;
  const size_t at_50 = ObjectPairs(TurntableScene(5, 10).station, TurntableScene(5, 10).view, options).size();
  for (const int factor : {2, 4, 8}) {
    const Scene finer = TurntableScene(5, 10 * factor);
    const Scene higher = TurntableScene(5 * factor, 10);
    // An image has at most max_partners in its own station and in each nearby one.
    const size_t limit = 50U * factor * options.max_partners * (1 + options.max_nearby_stations);
    EXPECT_LE(ObjectPairs(finer.station, finer.view, options).size(), limit);
    EXPECT_LE(ObjectPairs(higher.station, higher.view, options).size(), limit);
  }
  EXPECT_GT(at_50, 100U);
}

TEST(PairPlan, ObjectPairsLeaveOutUnknownViews) {
  Scene scene = TurntableScene(2, 8);
  scene.view[3].setZero();
  scene.view[4] = Eigen::Vector3d::Constant(std::nan(""));
  scene.station[5] = -1;
  for (const ImagePair pair : ObjectPairs(scene.station, scene.view, {})) {
    for (const uint32_t image : {pair.first, pair.second}) EXPECT_TRUE(image < 3 || image > 5) << image;
  }
}

TEST(PairPlan, ObjectPairOptionsOutsideTheirBoundsAreNamed) {
  EXPECT_FALSE(ObjectPairOptions{}.Check().has_value());
  EXPECT_EQ((ObjectPairOptions{0.0, 6, 2}.Check()->field), "max_view_angle_deg");
  EXPECT_EQ((ObjectPairOptions{std::nan(""), 6, 2}.Check()->field), "max_view_angle_deg");
  EXPECT_EQ((ObjectPairOptions{60.0, 0, 2}.Check()->field), "max_partners");
  EXPECT_EQ((ObjectPairOptions{60.0, 6, -1}.Check()->field), "max_nearby_stations");
}

}  // namespace
}  // namespace s2gs
