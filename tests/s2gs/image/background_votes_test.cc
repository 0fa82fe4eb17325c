#include "s2gs/image/background_votes.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

namespace s2gs {
namespace {

// Ranks: a photo more is as likely at any place among n.
TEST(BackgroundVotes, RangeLeavesOutWhatPassesBy) {
  std::vector<double> few = {3, 0, 5, 1};
  BackgroundRange range = FindBackgroundRange(&few);
  EXPECT_EQ(range.most, 5);
  EXPECT_DOUBLE_EQ(range.chance, 1.0 / 5);
  std::vector<double> many(20, 1);
  many[3] = 100;
  many[7] = 90;
  many[11] = 2;
  range = FindBackgroundRange(&many);
  EXPECT_EQ(range.most, 2);
  EXPECT_DOUBLE_EQ(range.chance, 3.0 / 21);
}

BackgroundVotes Votes(int photos, int differ, double chance = 0.1) {
  return {photos, differ, photos * chance};
}

// By hand: 3 of 3 at a chance of .1 have .001, 4 of 4 .0001; 2 of 2 that do not differ at .9 have .01.
TEST(BackgroundVotes, AreWeighedAgainstChance) {
  EXPECT_EQ(Weigh(Votes(4, 4), 0.9, 9), BackgroundSight::kThere);
  EXPECT_EQ(Weigh(Votes(3, 3), 0.9, 9), BackgroundSight::kThere);
  EXPECT_EQ(Weigh(Votes(3, 3), 0.9, 11), BackgroundSight::kUnknown);
  EXPECT_EQ(Weigh(Votes(3, 0), 0.9, 9), BackgroundSight::kNotThere);
  EXPECT_EQ(Weigh(Votes(3, 0), 0.9, 11), BackgroundSight::kUnknown);
  // A half: likelier a thing's than chance's, where things differ in half of the photos.
  EXPECT_EQ(Weigh(Votes(20, 10), 0.5, 100), BackgroundSight::kThere);
  EXPECT_EQ(Weigh(Votes(0, 0), 0.9, 1), BackgroundSight::kUnknown);
  // Where things differ no more often than the background, nothing is told.
  EXPECT_EQ(Weigh(Votes(50, 0), 0.1, 1), BackgroundSight::kUnknown);
  EXPECT_EQ(Weigh(Votes(50, 50), 0.1, 1), BackgroundSight::kUnknown);
}

TEST(BackgroundVotes, OfAKnownThing) {
  EXPECT_TRUE(DifferBeyondChance(Votes(3, 3)));
  EXPECT_FALSE(DifferBeyondChance(Votes(2, 2)));
  EXPECT_FALSE(DifferBeyondChance(Votes(0, 0)));
  EXPECT_DOUBLE_EQ(ShareWhereSomethingIs(Votes(8, 8)), 0.9);
  EXPECT_DOUBLE_EQ(ShareWhereSomethingIs(Votes(0, 0)), 0.5);
}

}  // namespace
}  // namespace s2gs
