#include "mesh/surface/triangle_tree.h"

#include <gtest/gtest.h>
#include <omp.h>

#include <algorithm>
#include <cmath>
#include <random>

#include "sfm_split/base/angles.h"

namespace s2gs {
namespace {

using Eigen::Vector3d;

TriangleCorners RandomTriangle(std::mt19937* random, double size) {
  std::normal_distribution<double> normal;
  TriangleCorners corners;
  const Vector3d centre(normal(*random), normal(*random), normal(*random));
  for (Vector3d& corner : corners) {
    corner = centre + size * Vector3d(normal(*random), normal(*random), normal(*random));
  }
  return corners;
}

// The distance by search: in each segment parallel to the last edge the nearest point is in closed form, and
// its distance is convex from the first corner to that edge, so that thirds close in on the least.
double DistanceBySearch(const Vector3d& x, const TriangleCorners& triangle) {
  const auto to_segment = [&](double u) {
    const Vector3d a = triangle[0] + u * (triangle[1] - triangle[0]);
    const Vector3d along = u * (triangle[2] - triangle[1]);
    const double length = along.norm();
    if (length == 0) return (x - a).norm();
    const double s = std::min(std::max((x - a).dot(along / length), 0.0), length);
    return (x - a - s / length * along).norm();
  };
  double low = 0, high = 1;
  for (int i = 0; i < 120; ++i) {
    const double left = low + (high - low) / 3, right = high - (high - low) / 3;
    if (to_segment(left) <= to_segment(right)) {
      high = right;
    } else {
      low = left;
    }
  }
  return std::min({to_segment(low), to_segment(0), to_segment(1)});
}

TEST(TriangleDistance, FaceEdgesAndCorners) {
  const TriangleCorners triangle = {Vector3d(0, 0, 0), Vector3d(4, 0, 0), Vector3d(0, 3, 0)};
  EXPECT_EQ(TriangleDistance({1, 1, 0}, triangle), 0);
  EXPECT_EQ(TriangleDistance({1, 1, 2}, triangle), 2);
  EXPECT_EQ(TriangleDistance({1, 1, -2}, triangle), 2);
  EXPECT_EQ(TriangleDistance({2, -3, 4}, triangle), 5);                    // below the first edge
  EXPECT_EQ(TriangleDistance({-4, 1, 3}, triangle), 5);                    // left of the third
  EXPECT_NEAR(TriangleDistance({2 + 3, 1.5 + 4, 0}, triangle), 5, 1e-14);  // beyond the middle of the second
  EXPECT_EQ(TriangleDistance({-3, -4, 12}, triangle), 13);
  EXPECT_EQ(TriangleDistance({7, -4, 0}, triangle), 5);
  EXPECT_EQ(TriangleDistance({-2, 5, 1}, triangle), 3);
}

TEST(TriangleDistance, EqualsASearch) {
  std::mt19937 random(1);
  std::normal_distribution<double> normal;
  double worst = 0;
  for (int i = 0; i < 2000; ++i) {
    const TriangleCorners triangle = RandomTriangle(&random, i % 2 == 0 ? 1 : 0.1);
    const Vector3d x(normal(random), normal(random), normal(random));
    worst = std::max(worst, std::abs(TriangleDistance(x, triangle) - DistanceBySearch(x, triangle)));
  }
  EXPECT_LT(worst, 2e-14);  // measured: 2e-15
}

TEST(TriangleDistance, SliversAndPoints) {
  std::mt19937 random(2);
  std::normal_distribution<double> normal;
  for (const double width : {1e-3, 1e-8, 1e-16, 1e-200, 0.0}) {
    for (int i = 0; i < 300; ++i) {
      TriangleCorners triangle = RandomTriangle(&random, 1);
      // The third corner lies on the edge of the others or beyond its end, `width` aside.
      const double t = -1 + 3 * (i % 10) / 9.0;
      triangle[2] = triangle[0] + t * (triangle[1] - triangle[0]) + width * triangle[2];
      const Vector3d x(normal(random), normal(random), normal(random));
      // Measured: 3e-15.
      EXPECT_NEAR(TriangleDistance(x, triangle), DistanceBySearch(x, triangle), 3e-14);
    }
  }
  const Vector3d corner(1, 2, 3);
  EXPECT_EQ(TriangleDistance({1, 5, 7}, {corner, corner, corner}), 5);
}

TEST(TriangleTree, EqualsAllTriangles) {
  std::mt19937 random(3);
  std::normal_distribution<double> normal;
  for (const int count : {1, 2, 4, 5, 9, 300}) {
    std::vector<TriangleCorners> triangles;
    for (int i = 0; i < count; ++i) triangles.push_back(RandomTriangle(&random, i % 7 == 0 ? 1 : 0.05));
    const TriangleTree tree(triangles);
    for (int i = 0; i < 200; ++i) {
      const Vector3d x = (i % 20 == 0 ? 100 : 1) * Vector3d(normal(random), normal(random), normal(random));
      double nearest = HUGE_VAL;
      for (const TriangleCorners& triangle : triangles) {
        nearest = std::min(nearest, DistanceBySearch(x, triangle));
      }
      EXPECT_NEAR(tree.Distance(x), nearest, 3e-13);  // measured: 2.8e-14 at a distance of 200
    }
  }
}

TEST(TriangleTree, EqualTrianglesAndFarAway) {
  const std::vector<TriangleCorners> equal(1000, {Vector3d(0, 0, 1), Vector3d(1, 0, 1), Vector3d(0, 1, 1)});
  EXPECT_EQ(TriangleTree(equal).Distance({0.25, 0.25, 3}), 2);
  std::vector<TriangleCorners> row;
  for (int i = 0; i < 1000; ++i) {
    const double x = 1e6 + i;
    row.push_back({Vector3d(x, 0, 0), Vector3d(x + 0.5, 0, 0), Vector3d(x, 1, 0)});
  }
  EXPECT_EQ(TriangleTree(row).Distance({1e6 + 500.75, 0, 0}), 0.25);
}

TEST(TriangleTree, UnitCubeInClosedForm) {
  std::vector<TriangleCorners> cube;
  for (int axis = 0; axis < 3; ++axis) {
    for (const double side : {-0.5, 0.5}) {
      const auto corner = [&](double u, double v) {
        Vector3d x;
        x[axis] = side;
        x[(axis + 1) % 3] = u;
        x[(axis + 2) % 3] = v;
        return x;
      };
      cube.push_back({corner(-.5, -.5), corner(.5, -.5), corner(.5, .5)});
      cube.push_back({corner(-.5, -.5), corner(.5, .5), corner(-.5, .5)});
    }
  }
  const TriangleTree tree(cube);
  std::mt19937 random(4);
  std::uniform_real_distribution<double> uniform(-1.5, 1.5);
  for (int i = 0; i < 2000; ++i) {
    const Vector3d x(uniform(random), uniform(random), uniform(random));
    const Vector3d beyond = x.cwiseAbs() - Vector3d::Constant(0.5);
    const double expected = beyond.maxCoeff() < 0 ? -beyond.maxCoeff() : beyond.cwiseMax(0).norm();
    ASSERT_NEAR(tree.Distance(x), expected, 1e-14);
  }
}

// A mesh between the spheres of radius cos(half an angle between its corners) and 1.
TEST(TriangleTree, SphereBetweenBounds) {
  constexpr int kRings = 60;
  const auto corner = [](int ring, int around) {
    const double polar = kPi * ring / kRings, azimuth = kPi * around / kRings;
    return Vector3d(std::sin(polar) * std::cos(azimuth), std::sin(polar) * std::sin(azimuth),
                    std::cos(polar));
  };
  std::vector<TriangleCorners> sphere;
  for (int ring = 0; ring < kRings; ++ring) {
    for (int i = 0; i < 2 * kRings; ++i) {
      sphere.push_back({corner(ring, i), corner(ring + 1, i), corner(ring, i + 1)});
      sphere.push_back({corner(ring, i + 1), corner(ring + 1, i), corner(ring + 1, i + 1)});
    }
  }
  // The corners of a triangle are at most the diagonal of a cell apart.
  const double sag = 1 - std::cos(kPi / kRings / std::sqrt(2.0));
  std::mt19937 random(5);
  std::normal_distribution<double> normal;
  std::vector<Vector3d> points;
  for (int i = 0; i < 3000; ++i) points.emplace_back(normal(random), normal(random), normal(random));
  const std::vector<double> distances = DistancesToTriangles(points, sphere);
  for (size_t i = 0; i < points.size(); ++i) {
    const double off = points[i].norm() - 1;
    ASSERT_GT(distances[i], std::abs(off) - (off < 0 ? sag : 0) - 1e-14);
    ASSERT_LT(distances[i], std::abs(off) + (off < 0 ? 0 : sag) + 1e-14);
  }
  const int num_threads = omp_get_max_threads();
  omp_set_num_threads(3);
  EXPECT_EQ(DistancesToTriangles(points, sphere), distances);
  omp_set_num_threads(num_threads);
  EXPECT_TRUE(DistancesToTriangles({}, sphere).empty());
}

}  // namespace
}  // namespace s2gs
