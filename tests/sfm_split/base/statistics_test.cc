#include "sfm_split/base/statistics.h"

#include <gtest/gtest.h>

#include <cmath>

namespace s2gs {
namespace {

TEST(Summarize, OddAndEvenCounts) {
  const Summary odd = Summarize({5, 1, 3});
  EXPECT_EQ(odd.count, 3);
  EXPECT_DOUBLE_EQ(odd.mean, 3);
  EXPECT_DOUBLE_EQ(odd.median, 3);
  EXPECT_DOUBLE_EQ(odd.min, 1);
  EXPECT_DOUBLE_EQ(odd.max, 5);
  const Summary even = Summarize({8, 1, 2, 4});
  EXPECT_DOUBLE_EQ(even.mean, 3.75);
  EXPECT_DOUBLE_EQ(even.median, 3);
  EXPECT_DOUBLE_EQ(even.max, 8);
}

TEST(Summarize, NothingIsNotZero) {
  const Summary summary = Summarize({});
  EXPECT_EQ(summary.count, 0);
  EXPECT_TRUE(std::isnan(summary.mean));
  EXPECT_TRUE(std::isnan(summary.median));
  EXPECT_TRUE(std::isnan(summary.min));
  EXPECT_TRUE(std::isnan(summary.max));
}

TEST(LogPoissonTail, IsTheSumOfTheProbabilities) {
  EXPECT_EQ(LogPoissonTail(0, 2), 0);
  // 1 - e^-2 (1 + 2 + 2)
  EXPECT_NEAR(std::exp(LogPoissonTail(3, 2)), 1 - 5 * std::exp(-2.0), 1e-12);
  EXPECT_NEAR(std::exp(LogPoissonTail(1, 0.01)), 1 - std::exp(-0.01), 1e-12);
  EXPECT_LT(LogPoissonTail(1000, 2), -1000);
}

}  // namespace
}  // namespace s2gs
