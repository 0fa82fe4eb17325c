#include "sfm_split/single_axis/image_turns.h"

#include <gtest/gtest.h>

#include <vector>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"

namespace s2gs {
namespace {

struct Pair {
  int image1;
  int image2;
  double angle_deg;
  double score;
};

ImageTurns Turns(int num_images, const std::vector<Pair>& pairs) {
  AxisRays rays;
  rays.cameras.resize(static_cast<size_t>(num_images));
  std::vector<TurnVote> votes;
  for (const Pair& pair : pairs) {
    rays.pairs.push_back({0, pair.image1, pair.image2, true, 1000, {}});
    votes.push_back({pair.angle_deg * kDegree, pair.score});
  }
  return SynchronizeTurns(rays, votes);
}

// Three matches that agree tie two images; two, as chance has them, do not.
TEST(SynchronizeTurns, TiesImagesByMoreVotesThanChanceGives) {
  const ImageTurns turns = Turns(4, {{0, 1, 30, 3}, {2, 1, -50, 3}, {2, 3, 20, 2}});
  EXPECT_EQ(turns.connected, (std::vector<char>{1, 1, 1, 0}));
  EXPECT_NEAR(WrapAngle(turns.angles[1] - turns.angles[0]), 30 * kDegree, 1e-6);
  EXPECT_NEAR(WrapAngle(turns.angles[2] - turns.angles[1]), 50 * kDegree, 1e-6);
}

// Around a circle; a pair that contradicts the others, surer than any of them, moves nothing.
TEST(SynchronizeTurns, OutliersAreOutvoted) {
  std::vector<Pair> pairs;
  for (int i = 0; i < 8; ++i) {
    pairs.push_back({i, (i + 1) % 8, 45, 20});
    pairs.push_back({i, (i + 2) % 8, 90, 20});
  }
  pairs.push_back({0, 4, 20, 15});
  const ImageTurns turns = Turns(8, pairs);
  for (int i = 1; i < 8; ++i) {
    EXPECT_NEAR(WrapAngle(turns.angles[static_cast<size_t>(i)] - turns.angles[0] - i * 45 * kDegree), 0,
                0.1 * kDegree);
  }
}

}  // namespace
}  // namespace s2gs
