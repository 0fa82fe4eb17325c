#include "sfm_split/relocalise/unmoved_keypoints.h"

#include <gtest/gtest.h>

#include <vector>

#include "tests/support/random_numbers.h"

namespace s2gs {
namespace {

TEST(UnmovedKeypoints, FollowTheCommonShift) {
  Keypoints first;
  Keypoints second;
  for (int k = 0; k < 50; ++k) {
    const int row = k / 10;
    first.emplace_back(static_cast<float>(13 * (k % 10) + 20), static_cast<float>(17 * row + 30));
    second.push_back(first.back() + Eigen::Vector2f(3.25F, -2.5F));
  }
  second[7] += Eigen::Vector2f(4, 0);  // moved
  std::vector<uint32_t> chosen = {0, 7, 20, 49};
  for (uint32_t k = 1; k < 49; ++k) chosen.push_back(k);
  std::vector<bool> usable(50, true);
  usable[20] = false;
  const std::vector<uint32_t> found = FindUnmovedKeypoints(first, chosen, second, usable, 8, 1.5F);
  EXPECT_EQ(found[0], 0U);
  EXPECT_EQ(found[1], kNoKeypoint);
  EXPECT_EQ(found[2], kNoKeypoint);
  EXPECT_EQ(found[3], 49U);
}

TEST(UnmovedKeypoints, AShiftThatChanceExplainsIsNone) {
  RandomNumbers random(11);
  Keypoints first;
  Keypoints second;
  std::vector<uint32_t> chosen;
  for (uint32_t k = 0; k < 300; ++k) {
    first.push_back(Eigen::Vector2d(random.Uniform(0, 640), random.Uniform(0, 480)).cast<float>());
    second.push_back(Eigen::Vector2d(random.Uniform(0, 640), random.Uniform(0, 480)).cast<float>());
    chosen.push_back(k);
  }
  const std::vector<bool> usable(300, true);
  for (const uint32_t other : FindUnmovedKeypoints(first, chosen, second, usable, 8, 1.5F))
    EXPECT_EQ(other, kNoKeypoint);
  for (uint32_t k = 0; k < 40; ++k) second[k] = first[k] + Eigen::Vector2f(5, -4);
  const std::vector<uint32_t> found = FindUnmovedKeypoints(first, chosen, second, usable, 8, 1.5F);
  for (uint32_t k = 0; k < 40; ++k) EXPECT_EQ(found[k], k);
}

}  // namespace
}  // namespace s2gs
