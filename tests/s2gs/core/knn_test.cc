#include "s2gs/core/knn.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <utility>
#include <vector>

#include "s2gs/core/rng.h"

namespace s2gs {
namespace {

std::vector<float> Points(size_t count) {
  std::vector<float> points(3 * count);
  for (size_t i = 0; i < points.size(); ++i) points[i] = UnitFloat(RandomBits(5, 0, i).words[0]);
  return points;
}

TEST(Knn, AgreesWithTryingAll) {
  const std::vector<float> points = Points(300);
  const Neighbours found = FindNeighbours(points, 4);
  ASSERT_EQ(found.k, 4);
  for (size_t i = 0; i < 300; ++i) {
    std::vector<std::pair<double, uint32_t>> all;
    for (size_t j = 0; j < 300; ++j) {
      if (i == j) continue;
      double d = 0;
      for (int c = 0; c < 3; ++c) {
        const double difference = double{points[3 * i + c]} - double{points[3 * j + c]};
        d += difference * difference;
      }
      all.emplace_back(d, static_cast<uint32_t>(j));
    }
    std::sort(all.begin(), all.end());
    for (int j = 0; j < 4; ++j) {
      EXPECT_EQ(found.index[4 * i + j], all[j].second);
      EXPECT_NEAR(found.distance_sq[4 * i + j], all[j].first, 1e-6);
    }
  }
}

TEST(Knn, DoesNotDependOnThreads) {
  const std::vector<float> points = Points(2000);
  const Neighbours one = FindNeighbours(points, 5, 1);
  const Neighbours two = FindNeighbours(points, 5, 2);
  EXPECT_EQ(one.index, two.index);
  EXPECT_EQ(one.distance_sq, two.distance_sq);
}

TEST(Knn, FewOrEqualPoints) {
  EXPECT_EQ(FindNeighbours({}, 3).k, 0);
  EXPECT_EQ(FindNeighbours({1, 2, 3}, 3).k, 0);
  EXPECT_EQ(FindNeighbours(Points(3), 5).k, 2);
  const Neighbours equal = FindNeighbours(std::vector<float>(60, 1.0F), 3);
  ASSERT_EQ(equal.index.size(), 60U);
  for (size_t i = 0; i < 20; ++i) {
    for (int j = 0; j < 3; ++j) {
      EXPECT_NE(equal.index[3 * i + j], i);
      EXPECT_EQ(equal.distance_sq[3 * i + j], 0);
    }
  }
}

}  // namespace
}  // namespace s2gs
