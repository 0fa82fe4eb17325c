#include "sfm_split/matching/keypoint_grid.h"

#include <gtest/gtest.h>

#include <random>
#include <set>
#include <vector>

namespace s2gs {
namespace {

// Compared with looking at every keypoint.
void ExpectAllFound(const Keypoints& keypoints, const std::vector<bool>& usable, float cell_px,
                    const std::vector<Eigen::Vector2f>& places, float radius) {
  const KeypointGrid grid(keypoints, cell_px, usable);
  for (const Eigen::Vector2f& place : places) {
    std::multiset<uint32_t> expected;
    for (uint32_t k = 0; k < keypoints.size(); ++k) {
      if ((usable.empty() || usable[k]) && (keypoints[k] - place).squaredNorm() <= radius * radius)
        expected.insert(k);
    }
    std::multiset<uint32_t> found;
    grid.ForEachWithin(place, radius, [&](uint32_t k, float squared) {
      found.insert(k);
      EXPECT_EQ(squared, (keypoints[k] - place).squaredNorm());
    });
    EXPECT_EQ(found, expected) << place.transpose();
  }
}

TEST(KeypointGrid, FindsWhatIsNear) {
  std::mt19937 rng(1);
  std::uniform_real_distribution<float> in_photo(0, 200);
  std::uniform_real_distribution<float> around(-40, 240);
  Keypoints keypoints;
  std::vector<bool> usable;
  std::vector<Eigen::Vector2f> places;
  for (int k = 0; k < 500; ++k) {
    keypoints.emplace_back(in_photo(rng), in_photo(rng));
    usable.push_back(rng() % 3 != 0);
    places.emplace_back(around(rng), around(rng));
  }
  for (const float cell_px : {0.01F, 4.0F, 1000.0F}) {
    for (const float radius : {0.0F, 1.5F, 25.0F}) {
      ExpectAllFound(keypoints, {}, cell_px, places, radius);
      ExpectAllFound(keypoints, usable, cell_px, places, radius);
      ExpectAllFound(keypoints, {}, cell_px, keypoints, radius);
    }
  }
}

TEST(KeypointGrid, OddInputs) {
  ExpectAllFound({}, {}, 4, {{0, 0}}, 10);
  ExpectAllFound({{1, 1}, {2, 2}}, {false, false}, 4, {{1, 1}}, 10);
  ExpectAllFound({{5, 5}, {5, 5}}, {}, 4, {{5, 5}, {6, 6}}, 1);
  // Far apart: as many cells as their distance suggests would not fit into memory.
  ExpectAllFound({{-1e9F, 3}, {7, 1e9F}, {1e30F, -1e30F}}, {}, 1e-3F, {{-1e9F, 3}, {7, 1e9F}, {0, 0}}, 100);
}

}  // namespace
}  // namespace s2gs
