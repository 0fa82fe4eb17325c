#include "s2gs/cpu/tile_lists.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <vector>

#include "sfm_split/base/error.h"
#include "tests/support/bad_input.h"
#include "tests/support/measured_bound.h"

namespace s2gs {
namespace {

// Splats that cover an image of 256 x 256 tiles.
std::vector<SplatRow> CoveringRows(size_t count, int size) {
  SplatRow row{};
  row.depth = 1;
  row.opacity = 1;
  row.x_end = row.y_end = size;
  return std::vector<SplatRow>(count, row);
}

// 2^32 pairs of a splat and a tile: 0 in 32 bits. They are counted, and nothing is allocated for them.
TEST(TileLists, CountsPairsIn64Bits) {
  constexpr int kTiles = 256;
  const std::vector<SplatRow> rows = CoveringRows(65'536, kTiles * kTileSize);
  ThreadPool threads(1);
  TileLists lists;
  const ScopedAllocationLimit limit(32 << 20);
  try {
    lists.Build(rows, kTiles * kTileSize, kTiles * kTileSize, &threads);
    FAIL() << "2^32 pairs were accepted";
  } catch (const UserError& error) {
    EXPECT_THAT(error.what(), testing::HasSubstr("2^32"));
  }
  EXPECT_EQ(lists.num_slots(), uint64_t{1} << 32U);
  ExpectWithin(numerics::kCounts, "largest allocation before 2^32 pairs of splat and tile are refused [MiB]",
               "cpu", static_cast<double>(ScopedAllocationLimit::LargestRequest()) / (1U << 20U), 32);
}

// 2^31 pairs whose gradients would take a terabyte and more: no machine has that.
TEST(TileLists, PairsBeyondTheMemoryAreRefused) {
  constexpr int kTiles = 256;
  const std::vector<SplatRow> rows = CoveringRows(32'768, kTiles * kTileSize);
  ThreadPool threads(1);
  TileLists lists;
  const ScopedAllocationLimit limit(32 << 20);
  ExpectUserError(
      [&] { lists.Build(rows, kTiles * kTileSize, kTiles * kTileSize, &threads, size_t{1} << 20U); },
      {"2147483648 tiles", "MiB are free"});
  ExpectWithin(numerics::kCounts, "largest allocation before 2^31 pairs are refused for their memory [MiB]",
               "cpu", static_cast<double>(ScopedAllocationLimit::LargestRequest()) / (1U << 20U), 32);
}

TEST(TileLists, ListsGoFromNearToFar) {
  constexpr int kTiles = 9;  // more than 64 in all
  std::vector<SplatRow> rows = CoveringRows(3, kTiles * kTileSize);
  rows[0].depth = 3;
  rows[1].depth = 1;
  rows[2].depth = 3;
  rows[1].x_end = kTileSize;
  ThreadPool threads(1);
  TileLists lists;
  lists.Build(rows, kTiles * kTileSize, kTiles * kTileSize, &threads);
  ASSERT_EQ(lists.num_tiles(), kTiles * kTiles);
  EXPECT_EQ(lists.num_slots(), 2U * kTiles * kTiles + kTiles);
  for (int tile = 0; tile < lists.num_tiles(); ++tile) {
    std::vector<uint32_t> splats;
    splats.reserve(lists.Entries(tile).size());
    for (const TileEntry& entry : lists.Entries(tile)) splats.push_back(entry.splat);
    const bool first_column = tile % kTiles == 0;
    EXPECT_EQ(splats, first_column ? std::vector<uint32_t>({1, 0, 2}) : std::vector<uint32_t>({0, 2}));
  }
}

}  // namespace
}  // namespace s2gs
