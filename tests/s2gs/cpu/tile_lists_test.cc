#include "s2gs/cpu/tile_lists.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <vector>

#include "sfm_split/base/error.h"
#include "tests/support/bad_input.h"
#include "tests/support/measured_bound.h"
#include "tests/support/random_numbers.h"

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

// Against the lists of all tiles, thinned out.
TEST(TileLists, TilesOfWantedSplatsAlone) {
  constexpr int kWidth = 19 * kTileSize - 5, kHeight = 11 * kTileSize;
  RandomNumbers random(7);
  std::vector<SplatRow> rows;
  std::vector<uint8_t> wanted;
  for (int i = 0; i < 300; ++i) {
    // Discs of one pixel to some tiles across, each tenth too large for the bits of its tiles.
    const double radius = i % 10 == 0 ? 100 : random.Uniform(1, 25);
    const double x = random.Uniform(0, kWidth), y = random.Uniform(0, kHeight);
    SplatRow row{};
    row.x = static_cast<float>(x);
    row.y = static_cast<float>(y);
    row.ux = row.vy = static_cast<float>(radius);
    row.depth = static_cast<float>(random.Uniform(1, 2));
    row.nz = -1;
    row.opacity = 1;
    row.cutoff2 = 1;
    row.x_begin = std::max(0, static_cast<int>(x - radius));
    row.y_begin = std::max(0, static_cast<int>(y - radius));
    row.x_end = std::min(kWidth, static_cast<int>(x + radius) + 1);
    row.y_end = std::min(kHeight, static_cast<int>(y + radius) + 1);
    if (i % 17 == 3) row.x_end = row.x_begin;  // not drawn
    rows.push_back(row);
    wanted.push_back(i % 10 != 0 && x < kWidth / 3.0 ? 1 : 0);
  }
  ThreadPool threads(2);
  TileLists all, some;
  all.Build(rows, kWidth, kHeight, &threads);
  some.Build(rows, kWidth, kHeight, &threads, 0, &wanted);
  const auto splats_of = [](const TileLists& lists, int tile) {
    std::vector<uint32_t> splats;
    for (const TileEntry& entry : lists.Entries(tile)) splats.push_back(entry.splat);
    return splats;
  };
  std::vector<int> splat_of_slot(some.num_slots(), -1);
  int num_listed = 0;
  for (int tile = 0; tile < all.num_tiles(); ++tile) {
    const std::vector<uint32_t> expected = splats_of(all, tile);
    const bool is_listed =
        std::any_of(expected.begin(), expected.end(), [&](uint32_t i) { return wanted[i] != 0; });
    EXPECT_EQ(some.IsListed(tile), is_listed) << tile;
    EXPECT_TRUE(all.IsListed(tile));
    EXPECT_EQ(splats_of(some, tile), is_listed ? expected : std::vector<uint32_t>()) << tile;
    num_listed += is_listed ? 1 : 0;
    for (const TileEntry& entry : some.Entries(tile)) {
      ASSERT_LT(entry.slot, splat_of_slot.size());
      EXPECT_EQ(splat_of_slot[entry.slot], -1);
      splat_of_slot[entry.slot] = static_cast<int>(entry.splat);
    }
  }
  EXPECT_GT(num_listed, 40);
  EXPECT_LT(num_listed, all.num_tiles() - 40);
  // Each slot is taken, and by the splat whose it is.
  for (size_t i = 0; i < rows.size(); ++i) {
    for (size_t slot = some.SlotBegin(i); slot < some.SlotBegin(i + 1); ++slot)
      EXPECT_EQ(splat_of_slot[slot], static_cast<int>(i));
  }
}

}  // namespace
}  // namespace s2gs
