#include "sfm_split/split/motion_sync.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdint>
#include <random>
#include <vector>

namespace s2gs {
namespace {

// Two bodies of 40 and 60 keypoints in every image. A pair shows each body's motion with a share of its
// keypoints, in random order of strength; `wrong` of the matches are the other body's.
struct TwoBodies {
  std::vector<Keypoints> keypoints;
  std::vector<VerifiedPair> motions;
  std::vector<int> truth;  // per motion: 0 is the larger body
};

TwoBodies MakeTwoBodies(int num_images, double wrong, uint64_t seed) {
  std::mt19937_64 random(seed);
  const auto chance = [&](double p) { return static_cast<double>(random() % 1000000) < 1e6 * p; };
  TwoBodies bodies;
  bodies.keypoints.assign(num_images, Keypoints(100, Eigen::Vector2f::Zero()));
  for (int i = 0; i < num_images; ++i) {
    for (int j = i + 1; j < std::min(num_images, i + 4); ++j) {
      std::vector<VerifiedPair> motions(2);
      for (int body = 0; body < 2; ++body) {
        motions[body].image1 = i;
        motions[body].image2 = j;
        for (uint32_t k = body == 0 ? 40 : 0; k < (body == 0 ? 100U : 40U); ++k) {
          if (chance(0.5)) continue;
          const uint32_t of_other = body == 0 ? k % 40 : 40 + k;
          const uint32_t keypoint = chance(wrong) ? of_other : k;
          motions[body].matches.push_back({keypoint, keypoint});
        }
      }
      const bool swapped = chance(0.5);
      for (const int body : {swapped ? 1 : 0, swapped ? 0 : 1}) {
        bodies.motions.push_back(motions[body]);
        bodies.truth.push_back(body);
      }
    }
  }
  return bodies;
}

TEST(SortIntoBodies, FindsTheTruthThroughWrongMatches) {
  for (uint64_t seed = 1; seed <= 20; ++seed) {
    for (const double wrong : {0.0, 0.1, 0.2}) {
      const TwoBodies bodies = MakeTwoBodies(20, wrong, seed);
      EXPECT_EQ(SortIntoBodies(bodies.keypoints, bodies.motions), bodies.truth) << seed << ' ' << wrong;
    }
  }
}

TEST(SortIntoBodies, OneMotionAPairIsOneBody) {
  TwoBodies bodies = MakeTwoBodies(12, 0.0, 1);
  std::vector<VerifiedPair> first;
  for (size_t m = 0; m < bodies.motions.size(); ++m) {
    if (bodies.truth[m] == 0) first.push_back(bodies.motions[m]);
  }
  EXPECT_EQ(SortIntoBodies(bodies.keypoints, first), std::vector<int>(first.size(), 0));
}

TEST(SortIntoBodies, NothingIsNothing) { EXPECT_TRUE(SortIntoBodies({}, {}).empty()); }

}  // namespace
}  // namespace s2gs
