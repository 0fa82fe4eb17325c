#include "s2gs/core/rng.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

namespace s2gs {
namespace {

// The known answers that the generator's authors publish.
TEST(Philox, KnownAnswers) {
  const auto expect = [](const Random4& actual, const Random4& expected) {
    for (int i = 0; i < 4; ++i) EXPECT_EQ(actual.words[i], expected.words[i]) << "word " << i;
  };
  expect(Philox4x32({{0, 0, 0, 0}}, 0, 0), {{0x6627e8d5, 0xe169c58d, 0xbc57ac4c, 0x9b00dbd8}});
  expect(Philox4x32({{0xffffffff, 0xffffffff, 0xffffffff, 0xffffffff}}, 0xffffffff, 0xffffffff),
         {{0x408f276d, 0x41c83b0e, 0xa20bc7c6, 0x6d5451fd}});
  expect(Philox4x32({{0x243f6a88, 0x85a308d3, 0x13198a2e, 0x03707344}}, 0xa4093822, 0x299f31d0),
         {{0xd16cfe09, 0x94fdcceb, 0x5001e420, 0x24126ea1}});
}

TEST(RandomBits, EachArgumentReachesTheGenerator) {
  const Random4 base = RandomBits(1, 2, 3);
  for (const Random4& other : {RandomBits(2, 2, 3), RandomBits(1 + (uint64_t{1} << 40), 2, 3),
                               RandomBits(1, 3, 3), RandomBits(1, 2 + (uint64_t{1} << 40), 3),
                               RandomBits(1, 2, 4), RandomBits(1, 2, 3 + (uint64_t{1} << 40))}) {
    EXPECT_NE(base.words[0], other.words[0]);
  }
}

TEST(UnitNumbers, EndsOfTheInterval) {
  EXPECT_EQ(UnitFloat(0), 0.0f);
  EXPECT_EQ(UnitFloat(0xffffffff), 1 - 0x1p-24f);
  EXPECT_EQ(UnitDouble(0, 0), 0.0);
  EXPECT_EQ(UnitDouble(0xffffffff, 0xffffffff), 1 - 0x1p-53);
  EXPECT_EQ(UnitDouble(0xffffffff), 1 - 0x1p-32);
}

TEST(UnitNumbers, UniformByChiSquare) {
  constexpr int kBins = 64;
  constexpr int kCount = 1 << 16;
  for (int word = 0; word < 4; ++word) {
    std::vector<int> bins(kBins);
    for (uint64_t i = 0; i < kCount; ++i) {
      ++bins[static_cast<int>(UnitDouble(RandomBits(7, 0, i).words[word]) * kBins)];
    }
    double chi_square = 0;
    for (const int count : bins) {
      const double expected = static_cast<double>(kCount) / kBins;
      chi_square += (count - expected) * (count - expected) / expected;
    }
    // 63 degrees of freedom: mean 63, standard deviation 11.2. The seed is fixed, so this cannot fail by
    // chance.
    EXPECT_GT(chi_square, 63 - 4 * 11.2);
    EXPECT_LT(chi_square, 63 + 4 * 11.2);
  }
}

}  // namespace
}  // namespace s2gs
