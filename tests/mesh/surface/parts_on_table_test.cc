#include "mesh/surface/parts_on_table.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

namespace s2gs {
namespace {

// A square table of 40 x 40 cells at z = 0 with square blocks on it: the surface steps up and down at their
// sides, and has no other gap.
struct Block {
  int column = 0;
  int row = 0;
  int side = 1;  // [cells]
};
TriangleMesh TableWith(const std::vector<Block>& blocks, double block_height) {
  constexpr int kCells = 40;
  TriangleMesh mesh;
  for (int y = 0; y <= kCells; ++y) {
    for (int x = 0; x <= kCells; ++x) {
      const bool is_on = std::any_of(blocks.begin(), blocks.end(), [&](const Block& block) {
        return x >= block.column && x <= block.column + block.side && y >= block.row &&
               y <= block.row + block.side;
      });
      mesh.vertices.emplace_back(static_cast<float>(x), static_cast<float>(y),
                                 is_on ? static_cast<float>(block_height) : 0.0F);
    }
  }
  for (uint32_t y = 0; y < kCells; ++y) {
    for (uint32_t x = 0; x < kCells; ++x) {
      const uint32_t at = y * (kCells + 1) + x;
      mesh.triangles.emplace_back(at, at + 1, at + kCells + 2);
      mesh.triangles.emplace_back(at, at + kCells + 2, at + kCells + 1);
    }
  }
  return mesh;
}

int64_t VerticesAbove(const TriangleMesh& mesh, float height) {
  return std::count_if(mesh.vertices.begin(), mesh.vertices.end(),
                       [&](const Eigen::Vector3f& v) { return v.z() > height; });
}

constexpr Block kLarge = {3, 3, 19};
constexpr Block kSmall = {30, 30, 1};

// The small block has 4 cells' tops and slopes where the large one has 400: between 1 and 5 %.
TEST(PartsOnTable, AreKeptByTheirShareOfTheLargest) {
  const TriangleMesh both = TableWith({kLarge, kSmall}, 1);
  TriangleMesh mesh = both;
  EXPECT_EQ(DropSmallPartsOnTable(0.1, 1, &mesh), 0);
  EXPECT_EQ(mesh.triangles.size(), both.triangles.size());
  EXPECT_EQ(DropSmallPartsOnTable(0.1, 5, &mesh), 1);
  EXPECT_EQ(VerticesAbove(mesh, 0.5F), VerticesAbove(TableWith({kLarge}, 1), 0.5F));
  // The table stays but for what led up to the small block: its 9 cells but the outer halves of two.
  EXPECT_EQ(mesh.triangles.size(), both.triangles.size() - 16);
}

TEST(PartsOnTable, StayOrGoAsPhotosSay) {
  const TriangleMesh both = TableWith({kLarge, kSmall}, 1);
  for (const PartSight small : {PartSight::kUnknown, PartSight::kThere, PartSight::kNotThere}) {
    const PartJudge judge = [&](const TriangleMesh&, const std::vector<int>& parts) {
      EXPECT_EQ(*std::max_element(parts.begin(), parts.end()), 1);
      EXPECT_EQ(*std::min_element(parts.begin(), parts.end()), kNoPart);
      return std::vector<PartSight>{PartSight::kUnknown, small};
    };
    TriangleMesh mesh = both;
    EXPECT_EQ(DropSmallPartsOnTable(0.1, 5, &mesh, judge), small == PartSight::kThere ? 0 : 1);
    mesh = both;
    EXPECT_EQ(DropSmallPartsOnTable(0.1, 1, &mesh, judge), small == PartSight::kNotThere ? 1 : 0);
  }
}

TEST(PartsOnTable, AreAllKeptWhereTheyAreAsLarge) {
  TriangleMesh mesh = TableWith({kLarge, {24, 24, 14}}, 1);
  EXPECT_EQ(DropSmallPartsOnTable(0.1, 30, &mesh), 0);
  EXPECT_EQ(DropSmallPartsOnTable(0.1, 100, &mesh), 1);
  EXPECT_EQ(VerticesAbove(mesh, 0.5F), VerticesAbove(TableWith({kLarge}, 1), 0.5F));
}

// What joins two parts above the height makes them one.
TEST(PartsOnTable, AreWhatHangsTogetherAboveTheTop) {
  TriangleMesh mesh = TableWith({kLarge, {22, 10, 8}}, 1);
  const size_t before = mesh.triangles.size();
  EXPECT_EQ(DropSmallPartsOnTable(0.1, 50, &mesh), 0);
  EXPECT_EQ(mesh.triangles.size(), before);
}

TEST(PartsOnTable, NeedNotBeThere) {
  TriangleMesh mesh = TableWith({}, 1);
  const size_t before = mesh.triangles.size();
  EXPECT_EQ(DropSmallPartsOnTable(0.1, 50, &mesh), 0);
  EXPECT_EQ(mesh.triangles.size(), before);
  TriangleMesh empty;
  EXPECT_EQ(DropSmallPartsOnTable(0, 50, &empty), 0);
}

}  // namespace
}  // namespace s2gs
