#include <thrust/iterator/transform_iterator.h>

#include <cub/device/device_radix_sort.cuh>
#include <cub/device/device_scan.cuh>
#include <limits>
#include <string>

#include "s2gs/cuda/bin.h"
#include "s2gs/cuda/tiles.cuh"

namespace s2gs::cuda {
namespace {

constexpr int kThreads = 128;

// Tile counts in depth order, as 64-bit numbers for the scan.
struct CountOf {
  const uint32_t* tile_counts;
  __host__ __device__ uint64_t operator()(uint32_t id) const { return tile_counts[id]; }
};

// offsets holds inclusive sums.
__global__ void ReportTotalKernel(const uint64_t* offsets, int count, StepReport* report) {
  report->num_intersections = offsets[count - 1];
  report->overflow = 0;
}

struct EmitInput {
  const uint32_t* sorted_ids;
  const uint64_t* offsets;
  ProjectedSplats splats;
  int count, width, height;
  uint64_t bound;
  const uint8_t* is_listed;
};

// Tiles that a wanted splat reaches.
__global__ __launch_bounds__(kThreads) void ListTilesKernel(ProjectedSplats splats, const float* logits,
                                                            ForegroundRule rule, int count, int width,
                                                            int height, uint8_t* is_listed) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  TileReach reach{};
  if (i < count && splats.tile_counts[i] > 0 && IsForeground(logits[i], rule)) {
    reach = ReachOf(splats, static_cast<uint32_t>(i));
    reach.end = ~uint64_t{0};
  }
  uint32_t mask = 0;
  ForEachTile(reach, width, height, nullptr, &mask,
              [&](uint32_t /*id*/, uint64_t /*position*/, int tile) { is_listed[tile] = 1; });
}

// Counts tiles anew; splats that reach no listed one are not drawn.
__global__ __launch_bounds__(kThreads) void CountListedKernel(ProjectedSplats splats,
                                                              const uint8_t* is_listed, int count, int width,
                                                              int height) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  TileReach reach{};
  const bool is_drawn = i < count && splats.tile_counts[i] > 0;
  if (is_drawn) reach = ReachOf(splats, static_cast<uint32_t>(i));
  uint32_t mask = 0;
  const int tiles = ForEachTile(reach, width, height, is_listed, &mask,
                                [](uint32_t /*id*/, uint64_t /*position*/, int /*tile*/) {});
  if (!is_drawn) return;
  splats.tile_counts[i] = static_cast<uint32_t>(tiles);
  splats.tile_masks[i] = mask;
  if (tiles == 0) splats.depth_keys[i] = kNotDrawn;
}

template <typename Key>
__global__ __launch_bounds__(kThreads) void EmitKernel(EmitInput in, Key* keys, uint32_t* ids,
                                                       StepReport* report) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  const int tiles_in_row = NumTiles(in.width);
  TileReach reach{};
  const auto put = [&](uint32_t id, uint64_t position, int tile) {
    keys[position] = static_cast<Key>(tile);
    ids[position] = id;
  };
  if (i < in.count) {
    const uint32_t id = in.sorted_ids[i];
    const uint32_t num_tiles = in.splats.tile_counts[id];
    const uint64_t end = in.offsets[i];
    if (i == in.count - 1) *report = {end, end > in.bound ? 1U : 0U};
    if (num_tiles > 0 && end - num_tiles < in.bound) {
      const uint64_t bounded_end = end < in.bound ? end : in.bound;
      uint64_t position = end - num_tiles;
      const PixelRect tiles = TilesOf(in.splats.rects[id]);
      if (NumCandidates(tiles) <= kMaskTiles) {
        const int columns = tiles.x_end - tiles.x_begin;
        uint32_t mask = in.splats.tile_masks[id];
        for (; mask != 0 && position < bounded_end; mask &= mask - 1, ++position) {
          const int candidate = __ffs(static_cast<int>(mask)) - 1;
          put(id, position,
              (tiles.y_begin + candidate / columns) * tiles_in_row + tiles.x_begin + candidate % columns);
        }
      } else {
        reach = ReachOf(in.splats, id);
        reach.offset = position;
        reach.end = bounded_end;
      }
    }
  }
  if (!__any_sync(0xFFFFFFFFU, NumCandidates(reach.tiles) > 0)) return;
  uint32_t mask = 0;
  ForEachTile(reach, in.width, in.height, in.is_listed, &mask, put);
}

// Where each tile's entries begin and end in the sorted list. Unused entries at the end have the key
// num_tiles or more.
template <typename Key>
__global__ void FindRangesKernel(const Key* keys, uint64_t bound, int num_tiles, const StepReport* report,
                                 uint32_t* begin, uint32_t* end) {
  const uint64_t i = static_cast<uint64_t>(blockIdx.x) * blockDim.x + threadIdx.x;
  const uint64_t count = min(report->num_intersections, bound);
  if (i >= count) return;
  const auto tile = static_cast<int64_t>(keys[i]);
  if (tile >= num_tiles) return;
  if (i == 0 || static_cast<int64_t>(keys[i - 1]) != tile) begin[tile] = static_cast<uint32_t>(i);
  if (i == count - 1 || static_cast<int64_t>(keys[i + 1]) != tile) end[tile] = static_cast<uint32_t>(i + 1);
}

// Tiles by the length of their lists, long ones first, to an eighth of an octave: what takes long should not
// begin last. One block.
constexpr int kOrderThreads = 1024;
constexpr int kLengths = 256;
__global__ __launch_bounds__(kOrderThreads) void OrderTilesKernel(const uint32_t* begin, const uint32_t* end,
                                                                  int num_tiles, uint32_t* order) {
  __shared__ uint32_t places[kLengths];
  const auto rank = [&](int tile) {
    const uint32_t length = end[tile] - begin[tile];
    // The exponent and three bits of the mantissa.
    const uint32_t octaves = length == 0 ? 0 : (__float_as_uint(static_cast<float>(length)) >> 20) - 127 * 8;
    return kLengths - 1 - min(octaves, kLengths - 1U);
  };
  const auto thread = static_cast<int>(threadIdx.x);
  if (thread < kLengths) places[thread] = 0;
  __syncthreads();
  for (int tile = thread; tile < num_tiles; tile += kOrderThreads) atomicAdd(places + rank(tile), 1U);
  __syncthreads();
  if (thread < 32) {
    // Exclusive sums: eight lengths a lane.
    constexpr int kPerLane = kLengths / 32;
    uint32_t counts[kPerLane];
    uint32_t sum = 0;
    for (int i = 0; i < kPerLane; ++i) {
      counts[i] = places[thread * kPerLane + i];
      sum += counts[i];
    }
    uint32_t before = sum;
    for (int offset = 1; offset < 32; offset *= 2) {
      const uint32_t other = __shfl_up_sync(0xFFFFFFFFU, before, offset);
      if (thread >= offset) before += other;
    }
    before -= sum;
    for (int i = 0; i < kPerLane; ++i) {
      places[thread * kPerLane + i] = before;
      before += counts[i];
    }
  }
  __syncthreads();
  for (int tile = thread; tile < num_tiles; tile += kOrderThreads) {
    order[atomicAdd(places + rank(tile), 1U)] = static_cast<uint32_t>(tile);
  }
}

int BitsFor(uint64_t value) {
  int bits = 1;
  while (bits < 63 && (uint64_t{1} << bits) <= value) ++bits;
  return bits;
}

}  // namespace

TileSorter::TileSorter(DeviceMemoryCount* memory)
    : splats_(memory),
      normal_z_(memory),
      cutoffs_(memory),
      depth_keys_(memory),
      ids_(memory),
      tile_counts_(memory),
      tile_masks_(memory),
      rects_(memory),
      sorted_depth_keys_(memory),
      sorted_ids_(memory),
      offsets_(memory),
      tile_keys_(memory),
      sorted_tile_keys_(memory),
      tile_ids_(memory),
      sorted_tile_ids_(memory),
      tile_begin_(memory),
      tile_end_(memory),
      tile_order_(memory),
      is_listed_(memory),
      scratch_(memory) {}

void TileSorter::Reserve(int64_t num_gaussians, int width, int height) {
  const auto n = static_cast<size_t>(num_gaussians);
  splats_.Reserve(n);
  normal_z_.Reserve(n);
  depth_keys_.Reserve(n);
  ids_.Reserve(n);
  tile_counts_.Reserve(n);
  tile_masks_.Reserve(n);
  rects_.Reserve(n);
  cutoffs_.Reserve(n);
  sorted_depth_keys_.Reserve(n);
  sorted_ids_.Reserve(n);
  offsets_.Reserve(n);
  const size_t num_tiles = static_cast<size_t>(NumTiles(width)) * static_cast<size_t>(NumTiles(height));
  tile_begin_.Reserve(num_tiles);
  tile_end_.Reserve(num_tiles);
  tile_order_.Reserve(num_tiles);
  is_listed_.Reserve(num_tiles);
}

void TileSorter::ReserveIntersections(int64_t num_intersections) {
  // Positions within the list are 32-bit; CUB counts in int.
  if (num_intersections > std::numeric_limits<int32_t>::max()) {
    throw UserError(
        "The view has " + std::to_string(num_intersections) +
        " pairs of a splat and a tile, more than 2^31. Use a smaller image size or fewer Gaussians");
  }
  const auto n = static_cast<size_t>(num_intersections);
  tile_keys_.Reserve(n);
  sorted_tile_keys_.Reserve(n);
  tile_ids_.Reserve(n);
  sorted_tile_ids_.Reserve(n);
}

const uint8_t* TileSorter::ListTilesOf(const float* logits, ForegroundRule rule, int64_t num_gaussians,
                                       int width, int height, cudaStream_t stream) {
  const int num_tiles = NumTiles(width) * NumTiles(height);
  CheckCuda(cudaMemsetAsync(is_listed_.get(), 0, num_tiles, stream), "listed tiles");
  const auto n = static_cast<int>(num_gaussians);
  ListTilesKernel<<<NumBlocks(n, kThreads), kThreads, 0, stream>>>(splats(), logits, rule, n, width, height,
                                                                   is_listed_.get());
  CountListedKernel<<<NumBlocks(n, kThreads), kThreads, 0, stream>>>(splats(), is_listed_.get(), n, width,
                                                                     height);
  CheckCuda(cudaGetLastError(), "listed tiles");
  return is_listed_.get();
}

void TileSorter::SortByDepth(int64_t num_gaussians, cudaStream_t stream) {
  const auto n = static_cast<int>(num_gaussians);
  const auto counts = thrust::make_transform_iterator(static_cast<const uint32_t*>(sorted_ids_.get()),
                                                      CountOf{tile_counts_.get()});
  size_t sort_bytes = 0, scan_bytes = 0;
  CheckCuda(cub::DeviceRadixSort::SortPairs(nullptr, sort_bytes, depth_keys_.get(), sorted_depth_keys_.get(),
                                            ids_.get(), sorted_ids_.get(), n, 0, kDepthBits, stream),
            "sort by depth");
  CheckCuda(cub::DeviceScan::InclusiveSum(nullptr, scan_bytes, counts, offsets_.get(), n, stream),
            "scan of tile counts");
  scratch_.Reserve(sort_bytes > scan_bytes ? sort_bytes : scan_bytes);
  CheckCuda(
      cub::DeviceRadixSort::SortPairs(scratch_.get(), sort_bytes, depth_keys_.get(), sorted_depth_keys_.get(),
                                      ids_.get(), sorted_ids_.get(), n, 0, kDepthBits, stream),
      "sort by depth");
  CheckCuda(cub::DeviceScan::InclusiveSum(scratch_.get(), scan_bytes, counts, offsets_.get(), n, stream),
            "scan of tile counts");
}

void TileSorter::ReportTotal(int64_t num_gaussians, StepReport* report, cudaStream_t stream) {
  ReportTotalKernel<<<1, 1, 0, stream>>>(offsets_.get(), static_cast<int>(num_gaussians), report);
  CheckCuda(cudaGetLastError(), "tile counts");
}

TileLists TileSorter::SortByTile(int64_t num_gaussians, int width, int height, int64_t bound,
                                 StepReport* report, cudaStream_t stream, const uint8_t* is_listed) {
  const int num_tiles = NumTiles(width) * NumTiles(height);
  CheckCuda(cudaMemsetAsync(tile_begin_.get(), 0, sizeof(uint32_t) * num_tiles, stream), "tile ranges");
  CheckCuda(cudaMemsetAsync(tile_end_.get(), 0, sizeof(uint32_t) * num_tiles, stream), "tile ranges");
  const TileLists lists = {tile_begin_.get(), tile_end_.get(), sorted_tile_ids_.get(), tile_order_.get()};
  const auto order = [&] {
    OrderTilesKernel<<<1, kOrderThreads, 0, stream>>>(tile_begin_.get(), tile_end_.get(), num_tiles,
                                                      tile_order_.get());
    CheckCuda(cudaGetLastError(), "tile order");
  };
  if (bound == 0) {
    order();
    return lists;
  }
  const auto sort = [&](auto* keys, auto* sorted_keys) {
    using Key = std::remove_pointer_t<decltype(keys)>;
    // Entries that no splat fills sort behind all tiles.
    CheckCuda(cudaMemsetAsync(keys, 0xFF, sizeof(Key) * bound, stream), "tile keys");
    const EmitInput input = {sorted_ids_.get(),
                             offsets_.get(),
                             splats(),
                             static_cast<int>(num_gaussians),
                             width,
                             height,
                             static_cast<uint64_t>(bound),
                             is_listed};
    EmitKernel<<<NumBlocks(num_gaussians, kThreads), kThreads, 0, stream>>>(input, keys, tile_ids_.get(),
                                                                            report);
    CheckCuda(cudaGetLastError(), "tile keys");
    const int bits = BitsFor(static_cast<uint64_t>(num_tiles));
    size_t bytes = 0;
    CheckCuda(
        cub::DeviceRadixSort::SortPairs(nullptr, bytes, keys, sorted_keys, tile_ids_.get(),
                                        sorted_tile_ids_.get(), static_cast<int>(bound), 0, bits, stream),
        "sort by tile");
    scratch_.Reserve(bytes);
    CheckCuda(
        cub::DeviceRadixSort::SortPairs(scratch_.get(), bytes, keys, sorted_keys, tile_ids_.get(),
                                        sorted_tile_ids_.get(), static_cast<int>(bound), 0, bits, stream),
        "sort by tile");
    FindRangesKernel<<<NumBlocks(bound, 256), 256, 0, stream>>>(
        sorted_keys, static_cast<uint64_t>(bound), num_tiles, report, tile_begin_.get(), tile_end_.get());
    CheckCuda(cudaGetLastError(), "tile ranges");
  };
  if (num_tiles < 0xFFFF) {
    sort(reinterpret_cast<uint16_t*>(tile_keys_.get()), reinterpret_cast<uint16_t*>(sorted_tile_keys_.get()));
  } else {
    sort(tile_keys_.get(), sorted_tile_keys_.get());
  }
  order();
  return lists;
}

}  // namespace s2gs::cuda
