#include "sfm_split/evidence/chance.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace s2gs {
namespace {

TEST(LeastAgreeingMatches, FairCoinsByCounting) {
  // Of 1024 ways to throw ten coins, 1 + 10 + 45 = 56 show eight heads or more, 1 + 10 = 11 nine or more.
  EXPECT_EQ(LeastAgreeingMatches(10, 0.5, 1, 56.5 / 1024), 8);
  EXPECT_EQ(LeastAgreeingMatches(10, 0.5, 1, 55.5 / 1024), 9);
  EXPECT_EQ(LeastAgreeingMatches(10, 0.5, 1, 10.5 / 1024), 10);
  EXPECT_EQ(LeastAgreeingMatches(10, 0.5, 1, 0.5 / 1024), 11);
  EXPECT_EQ(LeastAgreeingMatches(10, 0.5, 100, 5650.0 / 1024), 8);
}

TEST(LeastAgreeingMatches, Ends) {
  EXPECT_EQ(LeastAgreeingMatches(0, 0.1, 1, 0.5), 1);
  EXPECT_EQ(LeastAgreeingMatches(5, 0, 1e6, 1e-9), 1);
  EXPECT_EQ(LeastAgreeingMatches(5, 1, 1, 0.5), 6);
  EXPECT_EQ(LeastAgreeingMatches(4000, 0.999, 1e4, 1e-6), 4001);
}

// The best of many wrong hypotheses reaches the bound no more often than the risk: 2,000 scans of 300
// hypotheses, 40 matches each; 20 are expected at a risk of .01 (the union bound makes it a little fewer),
// and 34 are three standard deviations more.
TEST(LeastAgreeingMatches, ChanceReachesItAsRarelyAsAsked) {
  const int64_t least = LeastAgreeingMatches(40, 0.05, 300, 0.01);
  std::mt19937 random(7);
  std::binomial_distribution<int> agreeing(40, 0.05);
  int reached = 0;
  int nearly = 0;
  for (int scan = 0; scan < 2000; ++scan) {
    int best = 0;
    for (int hypothesis = 0; hypothesis < 300; ++hypothesis) best = std::max(best, agreeing(random));
    reached += best >= least ? 1 : 0;
    nearly += best >= least - 1 ? 1 : 0;
  }
  EXPECT_LE(reached, 34);
  EXPECT_GT(nearly, 34);
}

}  // namespace
}  // namespace s2gs
