#include "sfm_split/base/union_find.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <utility>
#include <vector>

namespace s2gs {
namespace {

TEST(UnionFind, RootsAreTheSmallestMembersWhateverTheOrderOfJoining) {
  std::vector<std::pair<uint32_t, uint32_t>> joins = {{7, 3}, {3, 5}, {8, 9}, {9, 1}, {6, 6}};
  std::sort(joins.begin(), joins.end());
  do {
    UnionFind sets(10);
    for (const auto& [a, b] : joins) EXPECT_EQ(sets.Join(a, b), a != b);
    const std::vector<uint32_t> expected = {0, 1, 2, 3, 4, 3, 6, 3, 1, 1};
    for (uint32_t i = 0; i < 10; ++i) EXPECT_EQ(sets.Root(i), expected[i]);
    EXPECT_FALSE(sets.Join(5, 7));
  } while (std::next_permutation(joins.begin(), joins.end()));
}

}  // namespace
}  // namespace s2gs
