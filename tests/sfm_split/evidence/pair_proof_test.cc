#include "sfm_split/evidence/pair_proof.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <set>

#include "sfm_split/adjust/track_triangulation.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/scene/axis_turn.h"
#include "tests/support/synthetic_scan.h"
#include "tests/support/synthetic_turntable.h"

namespace s2gs {
namespace {

constexpr double kBoundPx = 4;
constexpr double kRisk = 1.0 / 400;

// Keypoints anywhere in a photo, matched in the order of their indices.
struct Matched {
  Keypoints keypoints1;
  Keypoints keypoints2;
  FeatureMatches matches;

  void Add(const Eigen::Vector2f& xy1, const Eigen::Vector2f& xy2) {
    matches.push_back({static_cast<uint32_t>(keypoints1.size()), static_cast<uint32_t>(keypoints2.size())});
    keypoints1.push_back(xy1);
    keypoints2.push_back(xy2);
  }
};

Matched RandomMatches(int count, uint32_t seed) {
  std::mt19937 random(seed);
  std::uniform_real_distribution<float> x(0, 640);
  std::uniform_real_distribution<float> move(-40, 40);
  Matched result;
  for (int m = 0; m < count; ++m) {
    const Eigen::Vector2f xy(x(random), x(random));
    result.Add(xy, xy + Eigen::Vector2f(move(random), move(random)));
  }
  return result;
}

// Between two photos that differ by a shift along x, what moved by d at an angle a to it misses its line by
// d |sin a| / sqrt 2: within b for a share of (2 / pi) asin(sqrt 2 b / d) of all directions.
TEST(ChanceOfDirections, OfASidewaysMotionInClosedForm) {
  const MatchError sideways = [](const Eigen::Vector2d& xy1, const Eigen::Vector2d& xy2) {
    return std::abs(xy2.y() - xy1.y()) / std::sqrt(2.0);
  };
  for (const double moved : {3.0, 10.0, 60.0}) {
    Matched pair;
    for (int m = 0; m < 200; ++m) {
      const Eigen::Vector2f xy(static_cast<float>(3 * m), static_cast<float>(m));
      pair.Add(xy, xy + Eigen::Vector2f(static_cast<float>(moved), 0));
    }
    const double expected = 2 / kPi * std::asin(std::sqrt(2.0) * 1.5 / moved);
    // Of 4800 directions; one more of all is added, so that chance is never none.
    EXPECT_NEAR(ChanceOfDirections(pair.keypoints1, pair.keypoints2, pair.matches, sideways, 1.5), expected,
                0.002);
  }
}

// A pair of true neighbours, with the poses' error as a function of how far the table is said to stand from
// where it did.
class PairOfATurntable : public testing::Test {
 protected:
  PairOfATurntable() {
    SyntheticTurntableOptions options;
    options.stations = 1;
    options.steps = 18;
    options.step_deg = 20;
    options.num_object_points = 200;
    options.num_platter_points = 80;
    options.pixel_noise = 0.3;
    turntable_ = MakeSyntheticTurntable(options);
    features_ = SyntheticScanFeatures(turntable_);
    for (const ImagePairMatches& pair : features_.object_pairs) {
      if (pair.image1 != 0 || pair.image2 != 1) continue;
      for (const FeatureMatch& match : pair.matches) {
        pair_.Add(features_.images[0].keypoints[match.point2D_idx1],
                  features_.images[1].keypoints[match.point2D_idx2]);
      }
    }
  }

  MatchError Posed(double off_deg) const {
    std::vector<PosedImage> posed = TruePosesOfObject(turntable_);
    const View& second = turntable_.scene.views[1];
    posed[1].cam_from_body = second.cam_from_world * TurnAbout(turntable_.scene.axis, off_deg * kDegree) *
                             second.world_from_object;
    return [posed](const Eigen::Vector2d& xy1, const Eigen::Vector2d& xy2) {
      return MatchErrorPx(posed[0], posed[1], xy1, xy2);
    };
  }

  PairProof Prove(const Matched& pair, double off_deg) const {
    return ProvePair(pair.keypoints1, pair.keypoints2, pair.matches, Posed(off_deg), kBoundPx, kRisk);
  }

  // A body that turns and shifts in the picture, over the left half of it.
  static void AddOtherBody(int count, Matched* pair) {
    std::mt19937 random(5);
    std::uniform_real_distribution<float> x(0, 300);
    const Eigen::Rotation2Df turn(0.2F);
    for (int m = 0; m < count; ++m) {
      const Eigen::Vector2f xy(x(random), x(random));
      pair->Add(xy, turn * xy + Eigen::Vector2f(25, 60));
    }
  }

  SyntheticTurntable turntable_;
  ScanFeatures features_;
  Matched pair_;
};

TEST_F(PairOfATurntable, TruePosesAreBorneOut) {
  ASSERT_GT(pair_.matches.size(), 60);
  const PairProof proof = Prove(pair_, 0);
  EXPECT_TRUE(proof.is_proven);
  EXPECT_FALSE(proof.is_contradicted);
  EXPECT_FALSE(proof.has_other_body);
  EXPECT_GT(proof.proven.size(), 0.9 * pair_.matches.size());
}

TEST_F(PairOfATurntable, PosesOfAnotherTurnAreContradicted) {
  for (const double off : {-50.0, 60.0}) {
    const PairProof proof = Prove(pair_, off);
    EXPECT_TRUE(proof.is_proven) << off;
    EXPECT_TRUE(proof.is_contradicted) << off;
    EXPECT_FALSE(proof.has_other_body) << off;
  }
}

// Someone walks by with more details than the object has: that says nothing against the poses.
TEST_F(PairOfATurntable, AnotherBodyIsNoContradiction) {
  Matched both = pair_;
  AddOtherBody(2 * static_cast<int>(pair_.matches.size()), &both);
  const PairProof proof = Prove(both, 0);
  EXPECT_TRUE(proof.has_other_body);
  EXPECT_FALSE(proof.is_contradicted);
  const auto first_other = static_cast<int>(pair_.matches.size());
  EXPECT_GT(proof.others.size(), 0.9 * (both.matches.size() - pair_.matches.size()));
  for (const int m : proof.others) EXPECT_GE(m, first_other);
}

// Of 60 pairs with nothing but wrong matches, the poses are borne out, or a motion of their own is proven, in
// at most 2 of 400; two of sixty would be one case in a hundred.
TEST_F(PairOfATurntable, WrongMatchesProveNothing) {
  int proven = 0;
  for (uint32_t seed = 1; seed <= 60; ++seed)
    proven += Prove(RandomMatches(20 + static_cast<int>(seed), seed), 0).is_proven ? 1 : 0;
  EXPECT_LE(proven, 1);
}

TEST(DistinctDetails, OneOfThoseFoundSeveralTimes) {
  Matched pair;
  for (int m = 0; m < 5; ++m) pair.Add({100, 100}, {150, 120});
  pair.Add({200, 100}, {250, 120});
  EXPECT_EQ(DistinctDetails(pair.keypoints1, pair.keypoints2, pair.matches), (std::vector<int>{0, 5}));
}

}  // namespace
}  // namespace s2gs
