#include "s2gs/cpu/tile_lists.h"

#include <algorithm>
#include <array>
#include <cstring>
#include <limits>
#include <string>

#include "s2gs/kernel/intersect.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/machine_share.h"

namespace s2gs {
namespace {

constexpr uint64_t kBytesWorthAsking = uint64_t{1} << 30U;  // less is not worth the time that asking takes.

struct TileRect {
  int x_begin, y_begin, x_end, y_end;
  int Count() const { return (x_end - x_begin) * (y_end - y_begin); }
};

TileRect TilesOf(const SplatRow& row) {
  return {row.x_begin / kTileSize, row.y_begin / kTileSize, (row.x_end + kTileSize - 1) / kTileSize,
          (row.y_end + kTileSize - 1) / kTileSize};
}

bool IsDrawn(const SplatRow& row) { return row.x_begin < row.x_end; }

// The tiles of the rectangle that the splat reaches, row by row; all when they do not fit into 64 bits.
uint64_t Reached(const SplatRow& row, const TileRect& tiles, int width, int height) {
  const int count = tiles.Count();
  if (count == 1 || count > 64) return ~uint64_t{0};
  const Footprint<float> footprint = {{row.x, row.y},   {row.ux, row.uy}, {row.vx, row.vy},
                                      {row.wx, row.wy}, row.depth,        {row.nx, row.ny, row.nz}};
  uint64_t reached = 0;
  int bit = 0;
  for (int y = tiles.y_begin; y < tiles.y_end; ++y) {
    for (int x = tiles.x_begin; x < tiles.x_end; ++x, ++bit) {
      const auto x0 = static_cast<float>(x * kTileSize) + 0.5F;
      const auto y0 = static_cast<float>(y * kTileSize) + 0.5F;
      const auto x1 = static_cast<float>(std::min((x + 1) * kTileSize, width)) - 0.5F;
      const auto y1 = static_cast<float>(std::min((y + 1) * kTileSize, height)) - 0.5F;
      if (ReachesRect(footprint, row.cutoff2, x0, y0, x1, y1)) reached |= uint64_t{1} << bit;
    }
  }
  return reached;
}

}  // namespace

void TileLists::RefuseBeyondMemory(size_t bytes_per_slot) {
  const uint64_t kept = num_slots() * (sizeof(TileEntry) + bytes_per_slot);
  if (kept <= std::max(kept_bytes_, kBytesWorthAsking)) return;
  // A list grows by doubling: for a moment the old one and one of twice its size are there.
  const uint64_t needed = kept + num_slots() * 2 * sizeof(TileEntry);
  const uint64_t available = AvailableMemoryBytes();
  if (needed - kept_bytes_ > available) {
    throw UserError("the Gaussians cover " + std::to_string(num_slots()) +
                    " tiles of one image, which would take " + std::to_string(needed >> 20U) +
                    " MiB of memory; " + std::to_string(available >> 20U) +
                    " MiB are free. Use fewer Gaussians, or smaller images");
  }
  kept_bytes_ = kept;
}

void TileLists::SortByDepth(const std::vector<SplatRow>& rows) {
  keys_.clear();
  for (size_t i = 0; i < rows.size(); ++i) {
    if (tile_count_[i] == 0) continue;
    uint32_t bits = 0;  // depths are positive: their bits are in their order
    std::memcpy(&bits, &rows[i].depth, sizeof(bits));
    keys_.push_back(uint64_t{bits} << 32U | i);
  }
  // By digits of 11 bits of the depth.
  keys_out_.resize(keys_.size());
  for (const unsigned shift : {32U, 43U, 54U}) {
    std::array<uint32_t, 2049> begin{};
    for (const uint64_t key : keys_) ++begin[(key >> shift & 2047U) + 1];
    for (size_t d = 1; d < begin.size(); ++d) begin[d] += begin[d - 1];
    for (const uint64_t key : keys_) keys_out_[begin[key >> shift & 2047U]++] = key;
    keys_.swap(keys_out_);
  }
}

void TileLists::ListReached(const std::vector<SplatRow>& rows, const std::vector<uint8_t>& wanted) {
  is_listed_.assign(tiles_.size(), 0);
  for (size_t i = 0; i < rows.size(); ++i) {
    if (wanted[i] == 0 || !IsDrawn(rows[i])) continue;
    const TileRect tiles = TilesOf(rows[i]);
    const bool has_bits = tiles.Count() <= 64;
    int bit = 0;
    for (int y = tiles.y_begin; y < tiles.y_end; ++y) {
      for (int x = tiles.x_begin; x < tiles.x_end; ++x, ++bit) {
        if (!has_bits || (reached_[i] >> bit & 1U) != 0)
          is_listed_[static_cast<size_t>(y) * tiles_x_ + x] = 1;
      }
    }
  }
  const auto tiles_y = static_cast<int>(tiles_.size()) / tiles_x_;
  listed_before_.clear();
  for (int y = 0; y < tiles_y; ++y) {
    uint32_t count = 0;
    for (int x = 0; x < tiles_x_; ++x) {
      listed_before_.push_back(count);
      count += is_listed_[static_cast<size_t>(y) * tiles_x_ + x];
    }
    listed_before_.push_back(count);
  }
}

int TileLists::CountListed(int x_begin, int x_end, int y) const {
  if (is_listed_.empty()) return x_end - x_begin;
  const uint32_t* row = listed_before_.data() + static_cast<size_t>(y) * (tiles_x_ + 1);
  return static_cast<int>(row[x_end] - row[x_begin]);
}

void TileLists::Build(const std::vector<SplatRow>& rows, int width, int height, ThreadPool* threads,
                      size_t bytes_per_slot, const std::vector<uint8_t>* wanted) {
  tiles_x_ = (width + kTileSize - 1) / kTileSize;
  const int tiles_y = (height + kTileSize - 1) / kTileSize;
  tiles_.resize(static_cast<size_t>(tiles_x_) * tiles_y);
  CountTiles(rows, width, height, threads, wanted);
  slot_begin_.resize(rows.size() + 1);
  slot_begin_[0] = 0;
  for (size_t i = 0; i < rows.size(); ++i) slot_begin_[i + 1] = slot_begin_[i] + tile_count_[i];
  if (num_slots() > std::numeric_limits<uint32_t>::max()) {
    throw UserError("the Gaussians cover more than 2^32 tiles of one image. Use fewer, or smaller images");
  }
  RefuseBeyondMemory(bytes_per_slot);
  SortByDepth(rows);

  threads->For(tiles_y, 1, [&](int64_t row, int64_t) { FillRow(rows, static_cast<int>(row)); });
}

void TileLists::CountTiles(const std::vector<SplatRow>& rows, int width, int height, ThreadPool* threads,
                           const std::vector<uint8_t>* wanted) {
  reached_.resize(rows.size());
  tile_count_.resize(rows.size());
  const auto for_drawn = [&](const auto& body) {
    threads->For(static_cast<int64_t>(rows.size()), [&](int64_t begin, int64_t end) {
      for (int64_t i = begin; i < end; ++i) {
        tile_count_[i] = 0;
        if (IsDrawn(rows[i])) body(i, TilesOf(rows[i]));
      }
    });
  };
  const auto count_reached = [&](int64_t i, const TileRect& tiles) {
    if (tiles.Count() > 1 && tiles.Count() <= 64) {
      tile_count_[i] = static_cast<uint32_t>(__builtin_popcountll(reached_[i]));
      return;
    }
    for (int y = tiles.y_begin; y < tiles.y_end; ++y)
      tile_count_[i] += static_cast<uint32_t>(CountListed(tiles.x_begin, tiles.x_end, y));
  };
  is_listed_.clear();
  for_drawn([&](int64_t i, const TileRect& tiles) {
    reached_[i] = Reached(rows[i], tiles, width, height);
    if (wanted == nullptr) count_reached(i, tiles);
  });
  if (wanted != nullptr) {
    ListReached(rows, *wanted);
    for_drawn([&](int64_t i, const TileRect& tiles) {
      int bit = 0;
      for (int y = tiles.y_begin; y < tiles.y_end && tiles.Count() <= 64; ++y) {
        for (int x = tiles.x_begin; x < tiles.x_end; ++x, ++bit) {
          if (is_listed_[static_cast<size_t>(y) * tiles_x_ + x] == 0) reached_[i] &= ~(uint64_t{1} << bit);
        }
      }
      count_reached(i, tiles);
    });
  }
}

void TileLists::FillRow(const std::vector<SplatRow>& rows, int tile_y) {
  for (int x = 0; x < tiles_x_; ++x) tiles_[static_cast<size_t>(tile_y) * tiles_x_ + x].clear();
  for (const uint64_t key : keys_) {
    const auto i = static_cast<uint32_t>(key);
    const TileRect tiles = TilesOf(rows[i]);
    if (tile_y < tiles.y_begin || tile_y >= tiles.y_end) continue;
    const int across = tiles.x_end - tiles.x_begin;
    const bool has_bits = tiles.Count() <= 64 && tiles.Count() > 1;
    size_t in_rows_above = 0;
    for (int y = tiles.y_begin; y < tile_y && !has_bits; ++y)
      in_rows_above += CountListed(tiles.x_begin, tiles.x_end, y);
    for (int x = tiles.x_begin; x < tiles.x_end; ++x) {
      size_t slot = slot_begin_[i];
      if (has_bits) {
        const uint64_t bit = uint64_t{1} << ((tile_y - tiles.y_begin) * across + x - tiles.x_begin);
        if ((reached_[i] & bit) == 0) continue;
        slot += __builtin_popcountll(reached_[i] & (bit - 1));
      } else {
        if (!IsListed(tile_y * tiles_x_ + x)) continue;
        slot += in_rows_above + CountListed(tiles.x_begin, x, tile_y);
      }
      tiles_[static_cast<size_t>(tile_y) * tiles_x_ + x].push_back({i, static_cast<uint32_t>(slot)});
    }
  }
}

}  // namespace s2gs
