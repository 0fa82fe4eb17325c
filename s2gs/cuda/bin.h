#pragma once

#include "s2gs/core/cuda.h"
#include "s2gs/cuda/device_data.h"

namespace s2gs::cuda {

/// Sorts splats into tiles: by depth over all splats, then, stably, by tile over all pairs of a splat and a
/// tile that it reaches, with keys no longer than the number of tiles needs.
class TileSorter {
 public:
  explicit TileSorter(DeviceMemoryCount* memory);

  /// Buffers for so many Gaussians and tiles. Waits for the GPU when they grow.
  void Reserve(int64_t num_gaussians, int width, int height);
  void ReserveIntersections(int64_t num_intersections);

  ProjectedSplats splats() const {
    return {splats_.get(),      normal_z_.get(),   depth_keys_.get(), ids_.get(),
            tile_counts_.get(), tile_masks_.get(), rects_.get(),      cutoffs_.get()};
  }

  /// After the projection, before the sorts: only tiles that splats of the rotating part reach are listed,
  /// and splats that reach none of these are no longer drawn. Returns by tile whether it is listed.
  const uint8_t* ListTilesOf(const float* foreground_logits, ForegroundRule rule, int64_t num_gaussians,
                             int width, int height, cudaStream_t stream);

  /// Depth order and the places of all pairs.
  void SortByDepth(int64_t num_gaussians, cudaStream_t stream);
  /// How many pairs there are, before they are sorted by tile.
  void ReportTotal(int64_t num_gaussians, StepReport* report, cudaStream_t stream);
  /// The lists of all tiles, and the report. \param bound  room for intersections, at most what was reserved;
  /// if there are more, the rest is left out and report->overflow is set. 0: the report is left alone.
  /// \param is_listed  as ListTilesOf() gave it; null: all tiles.
  TileLists SortByTile(int64_t num_gaussians, int width, int height, int64_t bound, StepReport* report,
                       cudaStream_t stream, const uint8_t* is_listed = nullptr);

 private:
  DeviceBuffer<PackedSplat> splats_;
  DeviceBuffer<float> normal_z_, cutoffs_;
  DeviceBuffer<uint32_t> depth_keys_, ids_, tile_counts_, tile_masks_;
  DeviceBuffer<ushort4> rects_;
  DeviceBuffer<uint32_t> sorted_depth_keys_, sorted_ids_;
  DeviceBuffer<uint64_t> offsets_;
  DeviceBuffer<uint32_t> tile_keys_, sorted_tile_keys_;  ///< of 16 bits where these suffice.
  DeviceBuffer<uint32_t> tile_ids_, sorted_tile_ids_;
  DeviceBuffer<uint32_t> tile_begin_, tile_end_, tile_order_;
  DeviceBuffer<uint8_t> is_listed_;
  DeviceBuffer<char> scratch_;
};

}  // namespace s2gs::cuda
