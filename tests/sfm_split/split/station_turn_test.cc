#include "sfm_split/split/station_turn.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "sfm_split/base/angles.h"
#include "sfm_split/split/two_view_motion.h"

namespace s2gs {
namespace {

// A camera that looks at a table from `elevation_deg`, and points on it.
struct Table {
  double focal_px = 800;
  double elevation_deg = 30;
  double step_deg = 15;
  std::vector<Eigen::Vector3d> points;

  explicit Table(uint64_t seed) {
    std::mt19937_64 random(seed);
    std::uniform_real_distribution<double> side(-0.15, 0.15);
    for (int p = 0; p < 200; ++p) points.emplace_back(side(random), side(random), side(random));
  }

  Eigen::Vector2f Project(const Eigen::Vector3d& x, double angle_deg) const {
    const Eigen::Vector3d turned = Eigen::AngleAxisd(angle_deg * kDegree, Eigen::Vector3d::UnitZ()) * x;
    const double e = elevation_deg * kDegree;
    const Eigen::Vector3d right(1, 0, 0);
    const Eigen::Vector3d ahead(0, std::cos(e), -std::sin(e));
    const Eigen::Vector3d down = ahead.cross(right);
    const Eigen::Vector3d in_camera(right.dot(turned), down.dot(turned), ahead.dot(turned) + 0.7);
    return (focal_px * in_camera.head<2>() / in_camera.z() + Eigen::Vector2d(320, 240)).cast<float>();
  }

  // `told` steps apart by place, `turned` steps apart in truth.
  TurnMatches Matches(int told, double turned, double noise_px, uint64_t seed) const {
    std::mt19937_64 random(seed);
    std::normal_distribution<float> noise(0.0F, static_cast<float>(noise_px));
    TurnMatches matches;
    matches.steps = told;
    for (const Eigen::Vector3d& x : points) {
      matches.xy1.push_back(Project(x, 0) + Eigen::Vector2f(noise(random), noise(random)));
      matches.xy2.push_back(Project(x, turned * step_deg) + Eigen::Vector2f(noise(random), noise(random)));
    }
    return matches;
  }
};

TEST(StationTurn, FindsTheStepFromCloseMatches) {
  for (const double elevation_deg : {5.0, 30.0, 60.0}) {
    for (const double step_deg : {-20.0, 6.0, 36.0}) {
      Table table(1);
      table.elevation_deg = elevation_deg;
      table.step_deg = step_deg;
      std::vector<TurnMatches> close;
      for (int steps = 1; steps <= 3; ++steps) close.push_back(table.Matches(steps, steps, 0.3, steps));
      const auto turn = FitStationTurn(close, 24, {640, 480}, 1.5, 0.7);
      ASSERT_TRUE(turn.has_value()) << elevation_deg << ' ' << step_deg;
      EXPECT_GE(turn->inlier_share, 0.99);
      // Points that turn by the true angle fit; what is twice or a quarter turn off does not.
      EXPECT_TRUE(FitsItsAngle(*turn, table.Matches(5, 5, 0.3, 9), 1.5)) << elevation_deg << ' ' << step_deg;
      EXPECT_FALSE(FitsItsAngle(*turn, table.Matches(5, 5 + 90 / step_deg, 0.3, 9), 1.5))
          << elevation_deg << ' ' << step_deg;
    }
  }
}

TEST(StationTurn, FundamentalIsExactForExactPoints) {
  Table table(2);
  std::vector<TurnMatches> close;
  for (int steps = 1; steps <= 3; ++steps) close.push_back(table.Matches(steps, steps, 0.0, 1));
  const auto turn = FitStationTurn(close, 24, {640, 480}, 1.5, 0.7);
  ASSERT_TRUE(turn.has_value());
  const TurnMatches far = table.Matches(4, 4, 0.0, 1);
  const Eigen::Matrix3d F = turn->Fundamental(4 * turn->step_rad);
  // Largest seen: 0.002 px, of points given in single precision.
  for (size_t m = 0; m < far.xy1.size(); ++m) EXPECT_LE(SampsonErrorPx(F, far.xy1[m], far.xy2[m]), 0.02);
}

// Matches between the last photos and the first ones belong to the steps that close the circle, although 35
// steps of what the other matches say may miss it by a lot.
TEST(StationTurn, MatchesAcrossTheEndOfAFullTurnTellTheFocalLength) {
  Table table(4);
  table.focal_px = 768;
  table.elevation_deg = 25;
  table.step_deg = 10;
  table.points.resize(60);
  std::vector<TurnMatches> inside;
  std::vector<TurnMatches> close;
  for (int steps = 1; steps <= 3; ++steps) inside.push_back(table.Matches(steps, steps, 0.5, steps));
  close = inside;
  for (int steps = 33; steps <= 35; ++steps)
    close.push_back(table.Matches(steps, steps - 36, 0.5, static_cast<uint64_t>(steps)));

  const auto open = FitStationTurn(inside, 36, {640, 480}, 1.5, 0.7);
  ASSERT_TRUE(open.has_value());
  EXPECT_FALSE(open->is_full_turn);
  const auto full = FitStationTurn(close, 36, {640, 480}, 1.5, 0.7);
  ASSERT_TRUE(full.has_value());
  EXPECT_TRUE(full->is_full_turn);
  EXPECT_NEAR(full->step_rad, 10 * kDegree, 1e-12);
  // Measured over 20 seeds: 2.5 % at most; without the matches across the end up to 75 %.
  EXPECT_NEAR(full->focal_px, 768, 0.04 * 768);
  EXPECT_LT(std::abs(full->focal_px - 768), std::abs(open->focal_px - 768));
  EXPECT_TRUE(FitsItsAngle(*full, table.Matches(34, -2, 0.5, 77), 1.5));
  EXPECT_FALSE(FitsItsAngle(*full, table.Matches(34, 7, 0.5, 77), 1.5));
}

// Half a turn whose ends do not meet, and which a repeating pattern seems to close.
TEST(StationTurn, MatchesThatDoNotCloseTheCircleAreLeftAside) {
  Table table(5);
  std::vector<TurnMatches> close;
  for (int steps = 1; steps <= 3; ++steps) close.push_back(table.Matches(steps, steps, 0.3, steps));
  TurnMatches wrong = table.Matches(11, 11, 0.3, 8);
  std::reverse(wrong.xy2.begin(), wrong.xy2.end());
  close.push_back(wrong);
  const auto turn = FitStationTurn(close, 12, {640, 480}, 1.5, 0.7);
  ASSERT_TRUE(turn.has_value());
  EXPECT_FALSE(turn->is_full_turn);
  EXPECT_GE(turn->inlier_share, 0.99);
}

TEST(StationTurn, AKnownFocalLengthIsKept) {
  Table table(6);
  std::vector<TurnMatches> close;
  for (int steps = 1; steps <= 3; ++steps) close.push_back(table.Matches(steps, steps, 0.3, steps));
  const auto turn = FitStationTurn(close, 24, {640, 480}, 1.5, 0.7, table.focal_px);
  ASSERT_TRUE(turn.has_value());
  EXPECT_NEAR(turn->focal_px, table.focal_px, 1e-9 * table.focal_px);
  // Seen: 0.02 degrees.
  EXPECT_NEAR(std::abs(turn->step_rad), 15 * kDegree, 0.1 * kDegree);
}

TEST(StationTurn, RefusesMatchesThatDoNotTurn) {
  std::mt19937_64 random(3);
  std::uniform_real_distribution<float> place(0.0F, 640.0F);
  TurnMatches chaos;
  chaos.steps = 1;
  for (int m = 0; m < 300; ++m) {
    chaos.xy1.emplace_back(place(random), place(random));
    chaos.xy2.emplace_back(place(random), place(random));
  }
  EXPECT_FALSE(FitStationTurn({chaos}, 12, {640, 640}, 1.5, 0.7).has_value());
  EXPECT_FALSE(FitStationTurn({}, 12, {640, 640}, 1.5, 0.7).has_value());
}

}  // namespace
}  // namespace s2gs
