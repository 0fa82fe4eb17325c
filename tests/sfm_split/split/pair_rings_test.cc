#include "sfm_split/split/pair_rings.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>
#include <utility>
#include <vector>

#include "sfm_split/base/union_find.h"

namespace s2gs {
namespace {

using Pairs = std::vector<std::pair<int, int>>;

TEST(PairRings, AChainHasNoRingAndATurnThatClosesIsOne) {
  Pairs chain;
  for (int i = 0; i + 1 < 24; ++i) chain.emplace_back(i, i + 1);
  EXPECT_EQ(LargestRing(24, chain), 1);
  chain.emplace_back(23, 0);
  EXPECT_EQ(LargestRing(24, chain), 24);
  EXPECT_EQ(LargestRing(0, {}), 0);
  EXPECT_EQ(LargestRing(5, {}), 1);
  EXPECT_EQ(LargestRing(2, {{0, 1}, {1, 0}}), 1) << "one pair, named twice";
}

// By the definition: photos are in one set when no single pair's removal parts them.
int ByRemoval(int count, const Pairs& pairs) {
  std::vector<std::vector<bool>> together(static_cast<size_t>(count),
                                          std::vector<bool>(static_cast<size_t>(count), true));
  for (size_t without = 0; without <= pairs.size(); ++without) {
    UnionFind sets(static_cast<size_t>(count));
    for (size_t p = 0; p < pairs.size(); ++p) {
      if (without < pairs.size() && std::minmax(pairs[p].first, pairs[p].second) ==
                                        std::minmax(pairs[without].first, pairs[without].second)) {
        continue;
      }
      sets.Join(static_cast<uint32_t>(pairs[p].first), static_cast<uint32_t>(pairs[p].second));
    }
    for (int a = 0; a < count; ++a) {
      for (int b = 0; b < count; ++b) {
        if (sets.Root(static_cast<uint32_t>(a)) != sets.Root(static_cast<uint32_t>(b)))
          together[static_cast<size_t>(a)][static_cast<size_t>(b)] = false;
      }
    }
  }
  int largest = 0;
  for (const std::vector<bool>& row : together)
    largest = std::max(largest, static_cast<int>(std::count(row.begin(), row.end(), true)));
  return largest;
}

TEST(PairRings, AgreesWithTakingEachPairAway) {
  std::mt19937 rng(3);
  for (int round = 0; round < 300; ++round) {
    const int count = 1 + static_cast<int>(rng() % 12);
    Pairs pairs;
    const int num = static_cast<int>(rng() % 18);
    for (int p = 0; p < num; ++p) {
      const int a = static_cast<int>(rng() % static_cast<uint32_t>(count));
      const int b = static_cast<int>(rng() % static_cast<uint32_t>(count));
      if (a != b) pairs.emplace_back(a, b);
    }
    EXPECT_EQ(LargestRing(count, pairs), ByRemoval(count, pairs)) << "round " << round;
  }
}

}  // namespace
}  // namespace s2gs
