#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "s2gs/cpu/tile_kernel.h"
#include "sfm_split/base/thread_pool.h"

namespace s2gs {

/// Which splats each tile of a view shows, from near to far. Memory is kept between views.
class TileLists {
 public:
  /// \param rows  one per Gaussian; those with an empty rectangle are not drawn.
  /// \param bytes_per_slot  what the caller will keep of each slot, besides the list itself.
  /// Splats of equal depth stay in the order of their rows. Throws UserError, before anything of that size is
  /// allocated, when there are 2^32 slots or more memory would be needed than there is.
  /// \param wanted  when given, by row: tiles that none of the wanted splats reaches stay empty.
  void Build(const std::vector<SplatRow>& rows, int width, int height, ThreadPool* threads,
             size_t bytes_per_slot = 0, const std::vector<uint8_t>* wanted = nullptr);

  int tiles_x() const { return tiles_x_; }
  int num_tiles() const { return static_cast<int>(tiles_.size()); }
  const std::vector<TileEntry>& Entries(int tile) const { return tiles_[tile]; }
  /// Whether the tile is listed at all.
  bool IsListed(int tile) const { return is_listed_.empty() || is_listed_[tile] != 0; }
  /// Entries of all tiles; slots go from 0 to this.
  size_t num_slots() const { return slot_begin_.empty() ? 0 : slot_begin_.back(); }
  /// Slots of splat i: [SlotBegin(i), SlotBegin(i + 1)).
  size_t SlotBegin(size_t i) const { return slot_begin_[i]; }

 private:
  // How many tiles each splat reaches, and which; with `wanted`, of those that are listed.
  void CountTiles(const std::vector<SplatRow>& rows, int width, int height, ThreadPool* threads,
                  const std::vector<uint8_t>* wanted);
  // By one thread, which goes through all splats in order.
  void FillRow(const std::vector<SplatRow>& rows, int tile_y);
  void ListReached(const std::vector<SplatRow>& rows, const std::vector<uint8_t>& wanted);
  int CountListed(int x_begin, int x_end, int y) const;
  void SortByDepth(const std::vector<SplatRow>& rows);
  void RefuseBeyondMemory(size_t bytes_per_slot);

  int tiles_x_ = 0;
  std::vector<std::vector<TileEntry>> tiles_;
  std::vector<uint8_t> is_listed_;       // per tile; empty: all are
  std::vector<uint32_t> listed_before_;  // per tile: how many of its row stand left of it; one more a row
  std::vector<uint64_t> reached_;        // per splat: which tiles of its rectangle, when they are at most 64
  std::vector<uint32_t> tile_count_;     // per splat
  std::vector<size_t> slot_begin_;
  uint64_t kept_bytes_ = 0;                // that large views before this one took, and that are still there
  std::vector<uint64_t> keys_, keys_out_;  // depth and row of the drawn ones
};

}  // namespace s2gs
