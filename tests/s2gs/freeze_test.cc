#include "s2gs/freeze.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "s2gs/kernel/foreground.h"

namespace s2gs {
namespace {

float Logit(double p) { return static_cast<float>(std::log(p / (1 - p))); }

// A step of p that float logits tell apart near .8 and .9: their spacing is 2.4e-7, p's slope at most .16.
constexpr double kStep = 1e-6;

TEST(Freeze, SettledIsOutsideATenthAndNineTenths) {
  EXPECT_EQ(SettledShare({}), 1);
  EXPECT_EQ(SettledShare({Logit(0.1 - kStep)}), 1);
  EXPECT_EQ(SettledShare({Logit(0.1 + kStep)}), 0);
  EXPECT_EQ(SettledShare({Logit(0.9 - kStep)}), 0);
  EXPECT_EQ(SettledShare({Logit(0.9 + kStep)}), 1);
  EXPECT_EQ(SettledShare({0, 100, -100, Logit(0.5), Logit(0.8), Logit(0.95), -Logit(0.95), Logit(0.2)}), 0.5);
}

TEST(Freeze, TheBorderIsTau) {
  std::vector<float> logits = {Logit(0.8 - kStep),
                               Logit(0.8 + kStep),
                               Logit(0.5),
                               Logit(0.51),
                               Logit(0.79),
                               Logit(0.81),
                               -30,
                               30,
                               0,
                               -100};
  const std::vector<bool> rotates = {false, true, false, false, false, true, false, true, false, false};
  FreezeForeground(&logits);
  for (size_t i = 0; i < logits.size(); ++i) {
    const double p = Sigmoid(double{logits[i]});
    EXPECT_NEAR(p, rotates[i] ? 1 : 0, 5e-5) << i;
    // A frozen logit is one that training can still read: its entropy and slope are finite and not zero in
    // float.
    EXPECT_GT(SigmoidSlope(logits[i]), 0) << i;
  }
  // The share that is settled is all then, and freezing again changes nothing.
  EXPECT_EQ(SettledShare(logits), 1);
  std::vector<float> again = logits;
  FreezeForeground(&again);
  EXPECT_EQ(again, logits);
}

TEST(Freeze, WhatIsNotANumberDoesNotRotate) {
  std::vector<float> logits = {std::numeric_limits<float>::quiet_NaN()};
  EXPECT_EQ(SettledShare(logits), 0);
  FreezeForeground(&logits);
  EXPECT_LT(logits[0], 0);
}

// A cylinder of radius 2 around the vertical through (10, 0), from 1 below to 3 above the axis's point at
// height 5.
RotatingRegion Cylinder() {
  RotatingRegion region;
  region.axis.point = {10, 0, 5};
  region.axis.direction = {0, 0, 1};
  region.radius = 2;
  region.low = -1;
  region.high = 3;
  return region;
}

// Centres inside, outside sideways, below and above, and within a margin of .5 of each; the first of a pair
// rotates.
Placement Pairs() {
  Placement placement;
  for (const auto& [x, z] : {std::pair<float, float>{11.9F, 5},
                             {12.4F, 5},
                             {12.6F, 5},
                             {10, 3.6F},
                             {10, 3.4F},
                             {10, 8.4F},
                             {10, 8.6F}}) {
    for (const double p : {0.81, 0.79}) {
      placement.centre.insert(placement.centre.end(), {x, 0, z});
      placement.foreground_logit.push_back(Logit(p));
    }
  }
  return placement;
}

TEST(Freeze, KeepsWhatDoesNotRotateOrLiesInside) {
  const Placement placement = Pairs();
  EXPECT_EQ(KeepInsideRegion(placement, Cylinder(), 0.5),
            (std::vector<uint32_t>{0, 1, 2, 3, 5, 6, 7, 9, 10, 11, 13}));
  EXPECT_EQ(KeepInsideRegion(placement, Cylinder(), 0), (std::vector<uint32_t>{0, 1, 3, 5, 7, 9, 11, 13}));
  EXPECT_TRUE(KeepInsideRegion(Placement(), Cylinder(), 0).empty());
}

TEST(Freeze, DisownedAreUndecidedAndTheRestStays) {
  const Placement before = Pairs();
  Placement placement = before;
  EXPECT_EQ(DisownOutsideRegion(Cylinder(), 0.5, &placement), 3);
  EXPECT_EQ(placement.centre, before.centre);
  for (size_t i = 0; i < before.size(); ++i) {
    const bool is_disowned = i == 4 || i == 8 || i == 12;
    EXPECT_EQ(placement.foreground_logit[i], is_disowned ? 0 : before.foreground_logit[i]) << i;
  }
  EXPECT_EQ(DisownOutsideRegion(Cylinder(), 0.5, &placement), 0);
}

}  // namespace
}  // namespace s2gs
