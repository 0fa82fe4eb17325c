#include "s2gs/core/cuda.h"
#include "s2gs/cuda/render.h"
#include "s2gs/cuda/render_tile.cuh"
#include "s2gs/kernel/sh.h"

namespace s2gs::cuda {
namespace {

struct ForwardScratch {
  SplatGroup group;
  uint32_t queue[2 * kGroup];  // splats whose rectangle reaches the warp's.
};

__device__ bool ReachesWarp(const ProjectedSplats& splats, uint32_t id, const WarpPixel& where) {
  const ushort4 rect = splats.rects[id];
  return rect.x <= where.rect_x && where.rect_x < rect.z && rect.y <= where.rect_y && where.rect_y < rect.w;
}

// Draws the calling thread's pixel from front to back, in groups of 32 splats: lanes look at one splat each
// of the tile's list, and those that reach the warp queue up; of each group from the queue every lane works
// out which pixels one of its splats may hit; then every lane goes through the splats of its own pixel, lanes
// at different splats at the same time, because most splats hit few of the 32 pixels. Calls add(splat, hit,
// slot) for each hit, until that returns false: the pixel is done. All lanes call finish_group(id, added)
// after each group: the splat in the lane's slot, and the slots that were added to its pixel, a bit each.
template <typename C, typename Add, typename FinishGroup>
__device__ void DrawPixel(const RenderInput& in, const WarpPixel& where, ForwardScratch* scratch,
                          const Add& add, const FinishGroup& finish_group) {
  SplatGroup& group = scratch->group;
  uint32_t* const queue = scratch->queue;
  const unsigned lane = threadIdx.x % 32;
  const unsigned lanes_before = (1U << lane) - 1;
  const float pixel_x = static_cast<float>(where.x) + 0.5F, pixel_y = static_cast<float>(where.y) + 0.5F;
  const uint32_t end = in.tiles.end[where.tile];
  uint32_t first = in.tiles.begin[where.tile];
  uint32_t next_id = first + lane < end ? in.tiles.ids[first + lane] : 0;
  unsigned num_queued = 0;
  bool is_done = !where.is_inside;
  while (!__all_sync(kAllLanes, is_done)) {
    while (num_queued < kGroup && first < end) {
      const uint32_t id = next_id;
      const bool reaches = first + lane < end && ReachesWarp(in.splats, id, where);
      first += kGroup;
      next_id = first + lane < end ? in.tiles.ids[first + lane] : 0;
      const unsigned kept = __ballot_sync(kAllLanes, reaches);
      if (reaches) queue[num_queued + __popc(kept & lanes_before)] = id;
      num_queued += __popc(kept);
    }
    if (num_queued == 0) break;
    __syncwarp();
    const uint32_t id = lane < num_queued ? queue[lane] : 0;
    group.Load(in.splats, id, __ballot_sync(kAllLanes, lane < num_queued), C::kGeometry);
    const bool stays = lane + kGroup < num_queued;
    const uint32_t moved = stays ? queue[lane + kGroup] : 0;
    group.Wait();
    if (stays) queue[lane] = moved;
    unsigned pixels = 0;
    if (lane < num_queued) {
      const Splat<float> splat = group.At<Channels<false, false>>(lane);
      if (IsDrawableColor(splat.color)) {
        pixels =
            PixelsMayHit(splat.footprint, CutoffSquaredRadius(splat.opacity), where.x_begin, where.y_begin);
      }
    }
    num_queued -= min(num_queued, kGroup);
    unsigned hits = Transpose(pixels);
    unsigned added = 0;
    if (is_done) hits = 0;
    while (hits != 0) {
      const unsigned slot = __ffs(static_cast<int>(hits)) - 1;
      hits &= hits - 1;
      const Splat<float> splat = group.template At<C>(slot);
      PixelHit<float> hit;
      if (!HitSplat(splat.footprint, splat.opacity, pixel_x, pixel_y, in.near_depth, &hit)) continue;
      if (!add(splat, hit, slot)) {
        is_done = true;
        break;
      }
      added |= 1U << slot;
    }
    __syncwarp();
    finish_group(id, added);
  }
}

template <typename C, bool kListsHits>
__global__ __launch_bounds__(kDrawThreads) void RenderForwardKernel(RenderInput in, Maps maps,
                                                                    HitLists lists) {
  __shared__ ForwardScratch scratches[kDrawThreads / 32];
  const WarpPixel where = FindWarpPixel(in);
  const unsigned lane = threadIdx.x % 32;
  Pixel<float> pixel = EmptyPixel<float>();
  const auto add = [&](const Splat<float>& splat, const PixelHit<float>& hit, unsigned /*slot*/) {
    return AddHit<C>(splat, hit, in.near_depth, &pixel);
  };
  uint32_t num_hits = 0;
  const auto list_hits = [&](uint32_t id, unsigned added) {
    if constexpr (kListsHits) {
      const unsigned pixels = Transpose(added);
      const unsigned used = __ballot_sync(kAllLanes, pixels != 0);
      if (pixels != 0) {
        HitsOf(in, lists, where)[num_hits + __popc(used & ((1U << lane) - 1))] = {id, pixels};
      }
      num_hits += __popc(used);
    }
  };
  DrawPixel<C>(in, where, &scratches[threadIdx.x / 32], add, list_hits);
  if constexpr (kListsHits) {
    if (lane == 0) HitCountOf(lists, where) = num_hits;
  }

  if (!where.is_inside) return;
  const size_t size = static_cast<size_t>(in.width) * in.height;
  const size_t i = static_cast<size_t>(where.y) * in.width + where.x;
  maps.color[i] = pixel.color.x;
  maps.color[size + i] = pixel.color.y;
  maps.color[2 * size + i] = pixel.color.z;
  maps.transmittance[i] = pixel.transmittance;
  if constexpr (C::kForeground) maps.foreground[i] = pixel.foreground;
  if constexpr (C::kGeometry) {
    maps.weight[i] = pixel.weight;
    maps.depth[i] = pixel.depth;
    maps.normal[i] = pixel.normal.x;
    maps.normal[size + i] = pixel.normal.y;
    maps.normal[2 * size + i] = pixel.normal.z;
    if constexpr (!kListsHits) maps.median_depth[i] = pixel.median_depth;
  }
  if constexpr (C::kDistortion) {
    maps.distortion[i] = pixel.distortion;
    maps.m1[i] = pixel.m1;
    maps.m2[i] = pixel.m2;
  }
}

__global__ __launch_bounds__(kDrawThreads) void PeakWeightsKernel(RenderInput in, uint32_t* peak_bits,
                                                                  float* alpha) {
  using C = Channels<false, false>;
  __shared__ ForwardScratch scratches[kDrawThreads / 32];
  __shared__ uint32_t all_peaks[kDrawThreads / 32][kGroup];  // of the group's splats, as bits.
  uint32_t* const peaks = all_peaks[threadIdx.x / 32];
  const int lane = static_cast<int>(threadIdx.x) % 32;
  peaks[lane] = 0;
  __syncwarp();
  Pixel<float> pixel = EmptyPixel<float>();
  const auto add = [&](const Splat<float>& splat, const PixelHit<float>& hit, unsigned slot) {
    const float weight = hit.alpha * pixel.transmittance;
    if (!AddHit<C>(splat, hit, in.near_depth, &pixel)) return false;
    // Floats that are not negative are ordered as their bits.
    atomicMax(peaks + slot, __float_as_uint(weight));
    return true;
  };
  const auto raise_peaks = [&](uint32_t id, unsigned /*added*/) {
    if (peaks[lane] > 0) atomicMax(peak_bits + id, peaks[lane]);
    peaks[lane] = 0;
    __syncwarp();
  };
  const WarpPixel where = FindWarpPixel(in);
  DrawPixel<C>(in, where, &scratches[threadIdx.x / 32], add, raise_peaks);
  if (alpha != nullptr && where.is_inside) {
    alpha[static_cast<size_t>(where.y) * in.width + where.x] = 1 - pixel.transmittance;
  }
}

__global__ void MarkSeenKernel(const float* peak_weights, int64_t count, float min_weight, uint8_t* is_seen) {
  const int64_t i = static_cast<int64_t>(blockIdx.x) * blockDim.x + threadIdx.x;
  if (i < count) is_seen[i] = peak_weights[i] >= min_weight ? 1 : 0;
}

unsigned DrawGrid(const RenderInput& input) {
  return static_cast<unsigned>(NumTiles(input.width) * NumTiles(input.height) * kDrawBlocks);
}

}  // namespace

void RenderPeakWeights(const RenderInput& input, float* peak_weights, float* alpha, cudaStream_t stream) {
  PeakWeightsKernel<<<DrawGrid(input), kDrawThreads, 0, stream>>>(
      input, reinterpret_cast<uint32_t*>(peak_weights), alpha);
  CheckCuda(cudaGetLastError(), "peak weights");
}

void MarkSeen(const float* peak_weights, int64_t count, float min_weight, uint8_t* is_seen,
              cudaStream_t stream) {
  constexpr int kThreads = 256;
  MarkSeenKernel<<<NumBlocks(count, kThreads), kThreads, 0, stream>>>(peak_weights, count, min_weight,
                                                                      is_seen);
  CheckCuda(cudaGetLastError(), "what is seen");
}

void RenderForward(const RenderInput& input, RenderChannels channels, const Maps& maps, const HitLists& lists,
                   cudaStream_t stream) {
  WithChannels(channels, [&](auto of) {
    using C = decltype(of);
    if (lists.hits != nullptr) {
      RenderForwardKernel<C, true><<<DrawGrid(input), kDrawThreads, 0, stream>>>(input, maps, lists);
    } else {
      RenderForwardKernel<C, false><<<DrawGrid(input), kDrawThreads, 0, stream>>>(input, maps, lists);
    }
  });
  CheckCuda(cudaGetLastError(), "drawing");
}

}  // namespace s2gs::cuda
