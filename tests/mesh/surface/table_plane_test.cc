#include "mesh/surface/table_plane.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "sfm_split/base/angles.h"

namespace s2gs {
namespace {

constexpr double kRadius = 1;
constexpr double kTop = 0.2;
constexpr double kDome = 0.06;
constexpr int kSide = 101;
constexpr double kApart = 2.4 / (kSide - 1);

double HeightOfDome(double x, double y) {
  const double r = std::hypot(x, y);
  return r < kRadius ? kTop + kDome * (1 - r * r) : kTop - 0.3;
}

// A plain thing of .3 by .3 whose top is level and lower than domes may be, on a dome; below it the ground.
bool IsThing(double x, double y) { return std::abs(x - 0.3) < 0.15 && std::abs(y) < 0.15; }

TriangleMesh ThingOnDome() {
  TriangleMesh mesh;
  for (int i = 0; i < kSide; ++i) {
    for (int j = 0; j < kSide; ++j) {
      const double x = -1.2 + i * kApart;
      const double y = -1.2 + j * kApart;
      const double z = HeightOfDome(x, y) + (IsThing(x, y) ? 0.1 : 0);
      mesh.vertices.push_back(Eigen::Vector3d(x, y, z).cast<float>());
    }
  }
  for (uint32_t i = 0; i + 1 < kSide; ++i) {
    for (uint32_t j = 0; j + 1 < kSide; ++j) {
      const uint32_t a = i * kSide + j;
      mesh.triangles.emplace_back(a, a + kSide, a + kSide + 1);
      mesh.triangles.emplace_back(a, a + kSide + 1, a + 1);
    }
  }
  return mesh;
}

TEST(TablePlane, ADomeIsFlattenedAndWhatStandsOnItStays) {
  const TriangleMesh before = ThingOnDome();
  TriangleMesh mesh = before;
  MoveToHeight(kTop, LevelFromRim({kTop, kRadius, 1}, mesh), &mesh);
  ASSERT_EQ(mesh.normals.size(), mesh.vertices.size());
  for (size_t i = 0; i < mesh.vertices.size(); ++i) {
    const Eigen::Vector3f& x = before.vertices[i];
    const double r = std::hypot(x.x(), x.y());
    const bool is_at_edge = std::abs(r - kRadius) < 2 * kApart;
    if (is_at_edge) continue;  // its triangles are steep
    if (r < kRadius && !IsThing(x.x(), x.y())) {
      EXPECT_FLOAT_EQ(mesh.vertices[i].z(), kTop) << x.transpose();
    } else {
      EXPECT_EQ(mesh.vertices[i].z(), x.z()) << x.transpose();
    }
  }
}

TEST(TablePlane, NothingIsLevelFromARimThatTheSurfaceDoesNotReach) {
  const TriangleMesh mesh = ThingOnDome();
  EXPECT_TRUE(LevelFromRim({kTop + 0.15, kRadius, 1}, mesh).empty());
  EXPECT_TRUE(LevelFromRim({kTop - 0.2, kRadius, 1}, mesh).empty());
  EXPECT_TRUE(LevelFromRim({kTop, kRadius, 1}, TriangleMesh()).empty());
}

constexpr uint32_t kCorners = 24;

// Rings about the axis of these radii and heights above the top, each joined to the next; the first and the
// last on the plane are level.
struct Ring {
  double radius;
  double above;
};

TriangleMesh Rings(const std::vector<Ring>& rings) {
  TriangleMesh mesh;
  for (const Ring& ring : rings) {
    for (uint32_t i = 0; i < kCorners; ++i) {
      const double turn = 2 * kPi * i / kCorners;
      mesh.vertices.push_back(
          Eigen::Vector3d(ring.radius * std::cos(turn), ring.radius * std::sin(turn), kTop + ring.above)
              .cast<float>());
    }
  }
  for (uint32_t first = 0; first + kCorners < mesh.vertices.size(); first += kCorners) {
    for (uint32_t i = 0; i < kCorners; ++i) {
      const uint32_t a = first + i;
      const uint32_t b = first + (i + 1) % kCorners;
      mesh.triangles.emplace_back(a, b, b + kCorners);
      mesh.triangles.emplace_back(a, b + kCorners, a + kCorners);
    }
  }
  return mesh;
}

std::vector<uint32_t> StepsOf(const TriangleMesh& mesh, double seen_from) {
  std::vector<uint32_t> level;
  for (uint32_t v = 0; v < mesh.vertices.size(); ++v) {
    if (mesh.vertices[v].z() == static_cast<float>(kTop)) level.push_back(v);
  }
  return StepsOnPlane({kTop, kRadius, seen_from}, level, mesh);
}

// What is left of a step whose both edges were moved to the plane.
TEST(TablePlane, AStepThatTheTopHadIsNoBody) {
  const TriangleMesh fold = Rings({{0.5, 0}, {0.5, 0.1}, {0.49, 0}});
  EXPECT_EQ(StepsOf(fold, 1).size(), kCorners);
}

TEST(TablePlane, ABodyOnThePlaneIsNoStep) {
  EXPECT_TRUE(StepsOf(Rings({{0.1, 0}, {0.06, 0.15}, {1e-3, 0.15}}), 1).empty());               // a frustum
  EXPECT_TRUE(StepsOf(Rings({{0.05, 0}, {1e-3, 0.4}}), 1).empty());                             // a spike
  EXPECT_TRUE(StepsOf(Rings({{0.02, 0}, {0.1, 0.1}, {0.08, 0.15}, {1e-3, 0.17}}), 1).empty());  // a ball
}

// Wider above than where it stands.
TEST(TablePlane, ABodyWhoseTopNoCameraSawStays) {
  const TriangleMesh cup = Rings({{0.1, 0}, {0.3, 0.4}});
  EXPECT_TRUE(StepsOf(cup, kTop + 0.39).empty());
  EXPECT_EQ(StepsOf(cup, kTop + 0.41).size(), kCorners);
}

// A dish: what lies lower than the rim is no dome.
TEST(TablePlane, WhatLiesDeepBelowTheRimStays) {
  TriangleMesh mesh = ThingOnDome();
  for (Eigen::Vector3f& x : mesh.vertices) {
    const double r = std::hypot(x.x(), x.y());
    if (r < kRadius) x.z() = static_cast<float>(kTop - 0.15 * (1 - r * r));
  }
  const TriangleMesh before = mesh;
  MoveToHeight(kTop, LevelFromRim({kTop, kRadius, 1}, mesh), &mesh);
  const size_t middle = (kSide / 2) * kSide + kSide / 2;
  EXPECT_EQ(mesh.vertices[middle], before.vertices[middle]);
}

}  // namespace
}  // namespace s2gs
