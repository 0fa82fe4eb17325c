#include "mesh/surface/table_plane.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

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
  MoveToHeight(kTop, LevelFromRim(kTop, kRadius, mesh), &mesh);
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
  EXPECT_TRUE(LevelFromRim(kTop + 0.15, kRadius, mesh).empty());
  EXPECT_TRUE(LevelFromRim(kTop - 0.2, kRadius, mesh).empty());
  EXPECT_TRUE(LevelFromRim(kTop, kRadius, TriangleMesh()).empty());
}

// A dish: what lies lower than the rim is no dome.
TEST(TablePlane, WhatLiesDeepBelowTheRimStays) {
  TriangleMesh mesh = ThingOnDome();
  for (Eigen::Vector3f& x : mesh.vertices) {
    const double r = std::hypot(x.x(), x.y());
    if (r < kRadius) x.z() = static_cast<float>(kTop - 0.15 * (1 - r * r));
  }
  const TriangleMesh before = mesh;
  MoveToHeight(kTop, LevelFromRim(kTop, kRadius, mesh), &mesh);
  const size_t middle = (kSide / 2) * kSide + kSide / 2;
  EXPECT_EQ(mesh.vertices[middle], before.vertices[middle]);
}

}  // namespace
}  // namespace s2gs
