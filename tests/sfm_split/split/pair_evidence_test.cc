#include "sfm_split/split/pair_evidence.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <vector>

namespace s2gs {
namespace {

// The sum over the tail of the binomial distribution that the logarithm bounds, times the number of fits.
TEST(LogFalseAlarms, IsItsFormula) {
  // n = 20, k = 10, p = 0.1: log10(13 * C(20,10) * C(10,7) * 1e-3).
  EXPECT_NEAR(LogFalseAlarms(10, 20, 0.1), std::log10(13.0 * 184756.0 * 120.0 * 1e-3), 1e-9);
  EXPECT_EQ(LogFalseAlarms(7, 20, 0.1), 0.0);
}

TEST(LogFalseAlarms, FallsWithEveryInlier) {
  for (int k = 60; k < 150; ++k)
    EXPECT_LT(LogFalseAlarms(k + 1, 150, 0.05), LogFalseAlarms(k, 150, 0.05)) << k;
}

TEST(EpipolarInlierProbability, IsTheBandOverTheBox) {
  const Keypoints keypoints = {{0, 0}, {300, 400}};
  const FeatureMatches matches = {{0, 0}, {1, 1}};
  // A diagonal of 500 px, a band of 2 * sqrt(2) px on both sides of it.
  EXPECT_NEAR(EpipolarInlierProbability(keypoints, keypoints, matches, {0, 1}, 2.0),
              500 * 2 * std::sqrt(2.0) * 2 / (300.0 * 400.0), 1e-12);
}

// Points p in images of a line of places, keypoint index = point index, every image to every other.
struct Chain {
  std::vector<Keypoints> keypoints;
  std::vector<VerifiedPair> pairs;
};

Chain MakeChain(int num_images, uint32_t num_points) {
  Chain chain;
  for (int i = 0; i < num_images; ++i) {
    Keypoints keypoints;
    for (uint32_t p = 0; p < num_points; ++p)
      keypoints.emplace_back(10.0F * static_cast<float>(p), 7.0F * static_cast<float>(i));
    chain.keypoints.push_back(keypoints);
  }
  for (int i = 0; i < num_images; ++i) {
    for (int j = i + 1; j < num_images; ++j) {
      VerifiedPair pair;
      pair.image1 = i;
      pair.image2 = j;
      pair.log_false_alarms = -20;
      for (uint32_t p = 0; p < num_points; ++p) pair.matches.push_back({p, p});
      chain.pairs.push_back(pair);
    }
  }
  return chain;
}

TEST(FindPairSupport, CountsThirdImages) {
  Chain chain = MakeChain(5, 20);
  chain.pairs[0].matches[3] = {3, 4};  // one wrong match of images 0 and 1
  const std::vector<PairSupport> support = FindPairSupport(chain.keypoints, chain.pairs);
  EXPECT_EQ(support[0].num_confirmed, 19);
  EXPECT_EQ(support[0].num_contradicted, 1);
  EXPECT_EQ(support[0].balance[0], 3);   // images 2, 3 and 4 agree
  EXPECT_EQ(support[0].balance[3], -3);  // and put points 3 and 4 at two places
}

TEST(RemoveContradicted, TakesOutWrongPairsAndSingleWrongMatches) {
  Chain chain = MakeChain(6, 30);
  for (FeatureMatch& match : chain.pairs[4].matches)  // images 0 and 5: all wrong
    match.point2D_idx2 = (match.point2D_idx2 + 11) % 30;
  chain.pairs[0].matches[3] = {3, 4};
  RemoveContradicted(chain.keypoints, 15, &chain.pairs);
  EXPECT_EQ(chain.pairs.size(), 14U);
  for (const VerifiedPair& pair : chain.pairs) {
    for (const FeatureMatch& match : pair.matches) EXPECT_EQ(match.point2D_idx1, match.point2D_idx2);
  }
}

TEST(RemoveContradicted, KeepsWhatIsBetterThanChanceWithoutWitnesses) {
  Chain chain = MakeChain(2, 20);
  std::vector<VerifiedPair> unlikely = chain.pairs;
  unlikely[0].log_false_alarms = 0;
  RemoveContradicted(chain.keypoints, 15, &chain.pairs);
  RemoveContradicted(chain.keypoints, 15, &unlikely);
  EXPECT_EQ(chain.pairs.size(), 1U);
  EXPECT_TRUE(unlikely.empty());
}

}  // namespace
}  // namespace s2gs
