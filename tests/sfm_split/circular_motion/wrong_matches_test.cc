#include "sfm_split/circular_motion/wrong_matches.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <random>
#include <vector>

#include "sfm_split/base/angles.h"

namespace s2gs {
namespace {

constexpr int kPhotos = 24;
constexpr double kExtent = 80;

// Moves of photos far apart: a share of them of a thing that orbits, the others anywhere within the object.
std::vector<MatchMove> FarMoves(const Eigen::Matrix2d& map, double share, double sigma_px,
                                std::mt19937* random) {
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> uniform(-kExtent, kExtent);
  std::uniform_real_distribution<double> part;
  std::vector<MatchMove> moves;
  for (int place = 0; place < kPhotos; ++place) {
    for (int steps = 8; steps <= 12; ++steps) {
      for (int k = 0; k < 8; ++k) {
        MatchMove move;
        move.turn = TurnBetween(place, (place + steps) % kPhotos, kPhotos);
        move.px = {uniform(*random), uniform(*random)};
        if (part(*random) < share)
          move.px = map * move.turn + sigma_px * Eigen::Vector2d(normal(*random), normal(*random));
        moves.push_back(move);
      }
    }
  }
  return moves;
}

TEST(OrbitingThing, IsFoundAmongOtherMoves) {
  Eigen::Matrix2d map;
  map << -11, 5, 2, 6;
  for (const double share : {0.2, 0.5}) {
    for (unsigned seed = 1; seed <= 5; ++seed) {
      std::mt19937 random(seed);
      const OrbitingThing orbit = FindOrbitingThing(FarMoves(map, share, 1.5, &random), kExtent);
      // .17 px at most were measured where a fifth orbits, .11 where half does.
      EXPECT_LT((orbit.image_from_turn - map).cwiseAbs().maxCoeff(), 0.35) << share << " " << seed;
      EXPECT_NEAR(orbit.share, share, 0.1);
      EXPECT_NEAR(orbit.sigma_px, 1.5, 0.4);
    }
  }
}

TEST(OrbitingThing, IsNoneWhereMovesLieAnywhere) {
  for (unsigned seed = 1; seed <= 20; ++seed) {
    std::mt19937 random(seed);
    EXPECT_EQ(FindOrbitingThing(FarMoves(Eigen::Matrix2d::Identity(), 0, 1, &random), kExtent).share, 0)
        << seed;
  }
  EXPECT_EQ(FindOrbitingThing({}, kExtent).share, 0);
}

TEST(OrbitingThing, IsNotAThingThatTurns) {
  // Points all over a disc of 30 px that turns, seen from above: each goes around another way.
  std::mt19937 random(1);
  std::normal_distribution<double> normal;
  std::vector<MatchMove> moves;
  for (int k = 0; k < 960; ++k) {
    const int place = k % kPhotos;
    const int steps = 8 + k % 5;
    const Eigen::Vector2d x(30 * normal(random), 30 * normal(random));
    const auto at = [&](int photo) -> Eigen::Vector2d {
      return Eigen::Rotation2Dd(2 * kPi * photo / kPhotos) * x;
    };
    moves.push_back({at(place + steps) - at(place), TurnBetween(place, (place + steps) % kPhotos, kPhotos)});
  }
  EXPECT_LT(FindOrbitingThing(moves, kExtent).share, 0.1);
}

TEST(WrongMatches, MovesOfAnOrbitAreWhatChanceGives) {
  Eigen::Matrix2d map;
  map << -11, 5, 2, 6;
  std::mt19937 random(3);
  const WrongMatches wrong(FarMoves(map, 0.5, 1.5, &random), kExtent);
  const Eigen::Vector2d turn = TurnBetween(0, 3, kPhotos);  // of photos that are near each other
  const Eigen::Vector2d along = map * turn;
  // A share of .8 x .5 of the density's peak at the orbit, 1 / (2 pi 1.5^2), on a line as long as the object;
  // beside it what lies anywhere has 1 / (4 extent^2).
  EXPECT_NEAR(wrong.Chance({along, turn}), kExtent * 0.4 / (2 * kPi * 1.5 * 1.5), 0.7);
  EXPECT_LT(wrong.Chance({along + Eigen::Vector2d(15, 0), turn}), 0.1 * wrong.Chance({along, turn}));
}

TEST(WrongMatches, TurnsAreThoseOfAClosedTurn) {
  EXPECT_NEAR((TurnBetween(0, 12, 24) - Eigen::Vector2d(-2, 0)).norm(), 0, 1e-12);
  EXPECT_NEAR((TurnBetween(0, 6, 24) - Eigen::Vector2d(-1, 1)).norm(), 0, 1e-12);
  EXPECT_NEAR((TurnBetween(5, 9, 24) + TurnBetween(9, 5, 24)).norm(), 0, 1e-12);
}

}  // namespace
}  // namespace s2gs
