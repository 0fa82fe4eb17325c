#pragma once

#include "s2gs/cuda/device_data.h"

namespace s2gs::cuda {

/// The part of a splat that decides which tiles it reaches.
struct TileReach {
  Footprint<float> footprint;
  float cutoff2;
  PixelRect tiles;  ///< candidates; empty for splats that are not drawn.
  uint32_t id;
  uint64_t offset;  ///< of its first entry in the list of all pairs,
  uint64_t end;     ///< and one past its last.
};

/// The tiles that hold some of the warps' rectangles [x, z) x [y, w).
__device__ inline PixelRect TilesOf(const ushort4& rect) {
  constexpr int kColumns = kTile / kWarpWidth, kRows = kTile / kWarpHeight;
  return {rect.x / kColumns, rect.y / kRows, (rect.z + kColumns - 1) / kColumns,
          (rect.w + kRows - 1) / kRows};
}

/// Of a splat that was projected and is drawn.
__device__ inline TileReach ReachOf(const ProjectedSplats& splats, uint32_t id) {
  const float4 a = splats.splats[id].a, b = splats.splats[id].b;
  const ushort4 rect = splats.rects[id];
  TileReach reach{};
  reach.footprint.centre = {a.x, a.y};
  reach.footprint.u = {a.z, a.w};
  reach.footprint.v = {b.x, b.y};
  reach.footprint.w = {b.z, b.w};
  reach.cutoff2 = splats.cutoffs[id];
  reach.tiles = TilesOf(rect);
  reach.id = id;
  return reach;
}

__device__ inline bool ReachesTile(const TileReach& splat, int tile_x, int tile_y, int width, int height) {
  const float x0 = static_cast<float>(tile_x * kTile) + 0.5F;
  const float y0 = static_cast<float>(tile_y * kTile) + 0.5F;
  const float x1 = static_cast<float>(min((tile_x + 1) * kTile, width)) - 0.5F;
  const float y1 = static_cast<float>(min((tile_y + 1) * kTile, height)) - 0.5F;
  return ReachesRect(splat.footprint, splat.cutoff2, x0, y0, x1, y1);
}

/// Splats of at most so many candidates have a bit for each that they reach, row by row; the others have
/// none.
constexpr int kMaskTiles = 32;

__device__ inline int NumCandidates(const PixelRect& tiles) {
  return max(tiles.x_end - tiles.x_begin, 0) * max(tiles.y_end - tiles.y_begin, 0);
}

/// Calls emit(id, position, tile) for each tile that the splats of the warp's lanes reach, position counting
/// each splat's tiles from its offset, and returns the number of tiles of the calling lane's splat. Small
/// splats are left to their lanes, large ones are shared by the whole warp. All lanes must call it.
/// Positions from `end` on are left out: two kernels may round a tile on a splat's border to different sides,
/// so the second to look may find one more tile than the first, or leave one place unfilled.
/// \param is_listed  by tile: the others are passed over. Null: none is.
/// \param mask       out: of the calling lane's splat, if it has one.
template <typename Emit>
__device__ int ForEachTile(const TileReach& splat, int width, int height, const uint8_t* is_listed,
                           uint32_t* mask, const Emit& emit) {
  constexpr int kAlone = 12;
  constexpr unsigned kAll = 0xFFFFFFFFU;
  const int lane = static_cast<int>(threadIdx.x % 32);
  const int tiles_in_row = NumTiles(width);
  const int columns = splat.tiles.x_end - splat.tiles.x_begin;
  const int area = NumCandidates(splat.tiles);
  int count = 0;
  uint32_t reached = 0;
  if (area <= kAlone) {
    for (int i = 0; i < area; ++i) {
      const int tile_x = splat.tiles.x_begin + i % columns, tile_y = splat.tiles.y_begin + i / columns;
      if (is_listed != nullptr && is_listed[tile_y * tiles_in_row + tile_x] == 0) continue;
      if (area > 1 && !ReachesTile(splat, tile_x, tile_y, width, height)) continue;
      const uint64_t position = splat.offset + static_cast<uint64_t>(count);
      if (position < splat.end) emit(splat.id, position, tile_y * tiles_in_row + tile_x);
      reached |= 1U << i;
      ++count;
    }
  }
  unsigned shared = __ballot_sync(kAll, area > kAlone);
  while (shared != 0) {
    const int source = __ffs(static_cast<int>(shared)) - 1;
    shared &= shared - 1;
    const auto of_source = [&](auto value) { return __shfl_sync(kAll, value, source); };
    TileReach one{};
    one.footprint.centre = {of_source(splat.footprint.centre.x), of_source(splat.footprint.centre.y)};
    one.footprint.u = {of_source(splat.footprint.u.x), of_source(splat.footprint.u.y)};
    one.footprint.v = {of_source(splat.footprint.v.x), of_source(splat.footprint.v.y)};
    one.footprint.w = {of_source(splat.footprint.w.x), of_source(splat.footprint.w.y)};
    one.cutoff2 = of_source(splat.cutoff2);
    const int x_begin = of_source(splat.tiles.x_begin), y_begin = of_source(splat.tiles.y_begin);
    const int its_columns = of_source(columns), its_area = of_source(area);
    one.id = of_source(splat.id);
    one.offset = of_source(splat.offset);
    one.end = of_source(splat.end);
    int found = 0;
    for (int base = 0; base < its_area; base += 32) {
      const int i = base + lane;
      const int tile_x = x_begin + i % its_columns, tile_y = y_begin + i / its_columns;
      const bool reaches = i < its_area &&
                           (is_listed == nullptr || is_listed[tile_y * tiles_in_row + tile_x] != 0) &&
                           ReachesTile(one, tile_x, tile_y, width, height);
      const unsigned hits = __ballot_sync(kAll, reaches);
      if (reaches) {
        const uint64_t position =
            one.offset + static_cast<uint64_t>(found + __popc(hits & ((1U << lane) - 1)));
        if (position < one.end) emit(one.id, position, tile_y * tiles_in_row + tile_x);
      }
      if (lane == source) reached = hits;
      found += __popc(hits);
    }
    if (lane == source) count = found;
  }
  *mask = reached;
  return count;
}

}  // namespace s2gs::cuda
