#include "mesh/surface/table_top.h"

#include <gtest/gtest.h>

#include <Eigen/Core>
#include <cmath>
#include <optional>
#include <utility>

#include "sfm_split/base/angles.h"
#include "tests/mesh/surface/mesh_topology.h"
#include "tests/support/random_numbers.h"

namespace s2gs {
namespace {

// What a line in the half plane (radius, height) sweeps around the axis through (x, y). Walked downwards or
// inwards, its outside is away from the axis or below.
void Sweep(const Eigen::Vector2d& axis, const Eigen::Vector2d& from, const Eigen::Vector2d& to,
           TriangleMesh* mesh) {
  constexpr int kAround = 96;
  constexpr int kAlong = 40;
  const auto first = static_cast<uint32_t>(mesh->vertices.size());
  for (int i = 0; i <= kAlong; ++i) {
    const Eigen::Vector2d at = from + (to - from) * i / kAlong;
    for (int j = 0; j < kAround; ++j) {
      const double angle = 2 * kPi * j / kAround;
      mesh->vertices.emplace_back(static_cast<float>(axis.x() + at.x() * std::cos(angle)),
                                  static_cast<float>(axis.y() + at.x() * std::sin(angle)),
                                  static_cast<float>(at.y()));
    }
  }
  for (uint32_t i = 0; i < kAlong; ++i) {
    for (uint32_t j = 0; j < kAround; ++j) {
      const uint32_t next = (j + 1) % kAround;
      const uint32_t a = first + i * kAround + j;
      const uint32_t b = first + i * kAround + next;
      mesh->triangles.emplace_back(a, a + kAround, b);
      mesh->triangles.emplace_back(b, a + kAround, b + kAround);
    }
  }
}

constexpr double kHeight = -0.3;
constexpr double kRim = 1.5;

// A table's top with a can on it, beside the axis.
TriangleMesh CanOnTable() {
  TriangleMesh mesh;
  Sweep({0, 0}, {0.01, kHeight}, {kRim, kHeight}, &mesh);
  RandomNumbers random(3);
  for (Eigen::Vector3f& vertex : mesh.vertices) vertex.z() += static_cast<float>(0.002 * random.Normal());
  Sweep({0.2, 0.1}, {0.01, 1}, {0.6, 1}, &mesh);
  Sweep({0.2, 0.1}, {0.6, 1}, {0.6, kHeight}, &mesh);
  return mesh;
}

TEST(TableTop, EndsWhereItsPlaneEnds) {
  TriangleMesh mesh = CanOnTable();
  const MeshTopology clean = TopologyOf(mesh);
  // Cloth around it: a slope that begins at the rim, a level ring below that has half the table's area,
  // flaps that stand up; and a part that stands nowhere.
  Sweep({0, 0}, {kRim, kHeight}, {2.4, -1}, &mesh);
  Sweep({0, 0}, {1.7, -0.9}, {2.0, -0.9}, &mesh);
  Sweep({2.2, 0}, {0.3, 0.2}, {0.3, -0.8}, &mesh);
  Sweep({-1.9, 0}, {0.2, 0.6}, {0.2, 0.1}, &mesh);
  const std::optional<TableTop> table = FindTableTop(mesh);
  ASSERT_TRUE(table.has_value());
  // The noise is .002, over thousands of triangles.
  EXPECT_NEAR(table->disc.height, kHeight, 3e-4);
  // The slope falls by .7 over .9: so far it is within the plane's tolerance.
  const double tolerance = table->disc.Tolerance();
  EXPECT_GT(table->radius, kRim - table->disc.mean_edge);
  EXPECT_LT(table->radius, kRim + tolerance * 0.9 / 0.7 + 2 * table->disc.mean_edge);
  EXPECT_GT(CutAtTable(*table, &mesh), 0);
  // What is left is the can and the table, and of the slope what is within the tolerance: 11 % of the area.
  EXPECT_NEAR(TopologyOf(mesh).area, clean.area, 0.12 * clean.area);
  for (const Eigen::Vector3f& vertex : mesh.vertices) {
    EXPECT_LT(vertex.head<2>().norm(), table->radius + 0.1);
    EXPECT_GT(vertex.z(), table->disc.height - tolerance - 1e-5);
  }
}

TEST(TableTop, ACleanTableStaysAsItIs) {
  TriangleMesh mesh = CanOnTable();
  const MeshTopology before = TopologyOf(mesh);
  const std::optional<TableTop> table = FindTableTop(mesh);
  ASSERT_TRUE(table.has_value());
  CutAtTable(*table, &mesh);
  EXPECT_NEAR(TopologyOf(mesh).area, before.area, 1e-3 * before.area);
}

// More of it than of the plane above lies below the disc's border, but faces down.
TEST(TableTop, AnUndersideTakesNothingOfTheTop) {
  TriangleMesh mesh = CanOnTable();
  const double area = TopologyOf(mesh).area;
  Sweep({0, 0}, {kRim, kHeight - 0.2}, {1, kHeight - 0.6}, &mesh);
  const std::optional<TableTop> table = FindTableTop(mesh);
  ASSERT_TRUE(table.has_value());
  EXPECT_NEAR(table->radius, kRim, 2 * table->disc.mean_edge);
  CutAtTable(*table, &mesh);
  EXPECT_NEAR(TopologyOf(mesh).area, area, 1e-3 * area);
}

TEST(TableTop, WhatHangsOverTheRimStays) {
  TriangleMesh mesh;
  Sweep({0, 0}, {0.01, 0}, {0.8, 0}, &mesh);
  Sweep({0, 0}, {0.3, 1}, {0.3, 0}, &mesh);  // a stem
  TriangleMesh hat = mesh;
  Sweep({0, 0}, {0.3, 1}, {2, 1.5}, &hat);  // wider than the table
  const double area = TopologyOf(hat).area;
  const std::optional<TableTop> table = FindTableTop(hat);
  ASSERT_TRUE(table.has_value());
  EXPECT_NEAR(table->radius, 0.8, 0.05);
  CutAtTable(*table, &hat);
  EXPECT_NEAR(TopologyOf(hat).area, area, 1e-3 * area);
}

// Of the plane every triangle beyond the rim goes, though the plane goes on; of what stands above it, whole
// parts by their centres of area.
TEST(TableTop, ThePlaneEndsAtTheRimAndPartsStandOrFall) {
  TableTop table;
  table.disc.mean_edge = 0.02;
  table.radius = 1;
  TriangleMesh mesh;
  Sweep({0, 0}, {0.01, 0}, {2, 0}, &mesh);
  CutAtTable(table, &mesh);
  EXPECT_NEAR(TopologyOf(mesh).area, kPi, 0.06 * kPi);  // rings are .05 wide
  // Two boards above the plane: the centre of the first is over the table, that of the second is not.
  for (const double middle : {0.9, 1.1}) {
    TriangleMesh board;
    Sweep({middle, 0}, {0.01, 0.5}, {0.5, 0.5}, &board);
    const size_t count = board.triangles.size();
    const int64_t dropped = CutAtTable(table, &board);
    EXPECT_EQ(dropped, middle < 1 ? 0 : static_cast<int64_t>(count)) << middle;
  }
  // What lies below goes, what is within the tolerance of 1.5 edges stays.
  for (const double height : {-0.025, -0.035}) {
    TriangleMesh below;
    Sweep({0, 0}, {0.01, height}, {0.5, height}, &below);
    CutAtTable(table, &below);
    EXPECT_EQ(below.triangles.empty(), height < -0.03) << height;
  }
}

// Where the disc left nothing in the mesh, a flat base under a figure passes for a table.
TEST(TableTop, ABaseKeepsItsWalls) {
  for (const double flare : {-0.2, 0.0, 0.2}) {  // of its foot, over a height of .3
    TriangleMesh mesh;
    Sweep({0, 0}, {0.3, 0}, {1, 0}, &mesh);
    Sweep({0, 0}, {1, 0}, {1 + flare, -0.3}, &mesh);
    Sweep({0, 0}, {0.3, 2}, {0.3, 0}, &mesh);  // the figure
    const double area = TopologyOf(mesh).area;
    const std::optional<TableTop> table = FindTableTop(mesh);
    ASSERT_TRUE(table.has_value());
    EXPECT_NEAR(table->disc.height, 0, 1e-6);
    EXPECT_EQ(CutAtTable(*table, &mesh), 0) << "flare " << flare;
    EXPECT_EQ(TopologyOf(mesh).area, area);
  }
}

// Its top is larger than what is seen of the disc.
TEST(TableTop, TheDiscIsTheTableAndNotTheBaseOnIt) {
  TriangleMesh mesh;
  Sweep({0, 0}, {1, -0.2}, {1.3, -0.2}, &mesh);
  Sweep({0, 0}, {0.3, 0}, {1, 0}, &mesh);
  Sweep({0, 0}, {1, 0}, {1, -0.2}, &mesh);
  Sweep({0, 0}, {0.3, 2}, {0.3, 0}, &mesh);
  const std::optional<TableTop> table = FindTableTop(mesh);
  ASSERT_TRUE(table.has_value());
  EXPECT_NEAR(table->disc.height, -0.2, 1e-6);
  EXPECT_NEAR(table->radius, 1.3, 2 * table->disc.mean_edge);
}

// Flaps of the ground that hang below a part of the rim.
TEST(TableTop, WhatHangsBelowAPartOfTheRimGoes) {
  TriangleMesh mesh = CanOnTable();
  const double area = TopologyOf(mesh).area;
  TriangleMesh wall;
  Sweep({0, 0}, {kRim, kHeight}, {kRim, -1}, &wall);
  const auto first = static_cast<uint32_t>(mesh.vertices.size());
  mesh.vertices.insert(mesh.vertices.end(), wall.vertices.begin(), wall.vertices.end());
  for (const Triangle& triangle : wall.triangles) {
    const auto is_in_flap = [](uint32_t v) { return v % 96 < 40; };  // of 96 around the axis
    if (is_in_flap(triangle[0]) && is_in_flap(triangle[1]) && is_in_flap(triangle[2]))
      mesh.triangles.emplace_back(triangle + Triangle::Constant(first));
  }
  const std::optional<TableTop> table = FindTableTop(mesh);
  ASSERT_TRUE(table.has_value());
  CutAtTable(*table, &mesh);
  // What is within the tolerance stays, and a row of triangles: .08 of .7, 2.5 % of the area.
  EXPECT_NEAR(TopologyOf(mesh).area, area, 0.03 * area);
}

// Lids and ledges are no tables: cutting there would cost the object.
TEST(TableTop, LidsAndLedgesAreNone) {
  TriangleMesh can;
  Sweep({0, 0}, {0.01, 1}, {0.6, 1}, &can);
  Sweep({0, 0}, {0.6, 1}, {0.6, -1}, &can);
  EXPECT_FALSE(FindTableTop(can).has_value());
  TriangleMesh bottle;
  Sweep({0, 0}, {0.2, 1.5}, {0.2, 1}, &bottle);
  Sweep({0, 0}, {0.2, 1}, {0.6, 1}, &bottle);
  Sweep({0, 0}, {0.6, 1}, {0.6, -1}, &bottle);
  EXPECT_FALSE(FindTableTop(bottle).has_value());
  EXPECT_FALSE(FindTableTop(TriangleMesh()).has_value());
}

}  // namespace
}  // namespace s2gs
