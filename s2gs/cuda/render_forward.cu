#include "s2gs/core/cuda.h"
#include "s2gs/cuda/render.h"
#include "s2gs/cuda/render_tile.cuh"

namespace s2gs::cuda {
namespace {

// Draws the calling thread's pixel from front to back. Calls add(splat, hit, slot, pixel) for each of its
// hits, until that returns false: the pixel is done. finish_group() is called by all lanes after each group.
template <typename C, typename Add, typename FinishGroup>
__device__ void DrawPixel(const RenderInput& in, const WarpPixel& where, SplatGroup* group, const Add& add,
                          const FinishGroup& finish_group) {
  const unsigned lane = threadIdx.x % 32;
  const float pixel_x = static_cast<float>(where.x) + 0.5F, pixel_y = static_cast<float>(where.y) + 0.5F;
  const uint32_t begin = in.tiles.begin[where.tile], end = in.tiles.end[where.tile];
  bool is_done = !where.is_inside;
  uint32_t next_id = begin + lane < end ? in.tiles.ids[begin + lane] : 0;
  for (uint32_t first = begin; first < end; first += kGroup) {
    if (__all_sync(kAllLanes, is_done)) break;
    const uint32_t id = next_id;
    const uint32_t at = first + lane;
    next_id = at + kGroup < end ? in.tiles.ids[at + kGroup] : 0;
    const int count = group->Keep(in, where, at < end, id, at - begin, C::kGeometry);
    unsigned hits = 0;
    for (int slot = 0; slot < count; ++slot) {
      if (group->MayHit(slot, pixel_x, pixel_y)) hits |= 1U << slot;
    }
    if (is_done) hits = 0;
    while (hits != 0) {
      const int slot = __ffs(static_cast<int>(hits)) - 1;
      hits &= hits - 1;
      const Splat<float> splat = group->template At<C>(slot);
      PixelHit<float> hit;
      if (!HitSplat(splat.footprint, splat.opacity, pixel_x, pixel_y, in.near_depth, &hit)) continue;
      if (!add(splat, hit, slot)) {
        is_done = true;
        break;
      }
    }
    __syncwarp();
    finish_group(count);
  }
}

template <typename C>
__global__ __launch_bounds__(kDrawThreads) void RenderForwardKernel(RenderInput in, Maps maps) {
  __shared__ SplatGroup groups[kDrawThreads / 32];
  SplatGroup& group = groups[threadIdx.x / 32];
  const WarpPixel where = FindWarpPixel(in);
  Pixel<float> pixel = EmptyPixel<float>();
  uint32_t last = 0;
  const auto add = [&](const Splat<float>& splat, const PixelHit<float>& hit, int slot) {
    if (!AddHit<C>(splat, hit, in.near_depth, &pixel)) return false;
    last = group.number[slot] + 1;
    return true;
  };
  DrawPixel<C>(in, where, &group, add, [](int /*count*/) {});

  if (!where.is_inside) return;
  const size_t size = static_cast<size_t>(in.width) * in.height;
  const size_t i = static_cast<size_t>(where.y) * in.width + where.x;
  maps.color[i] = pixel.color.x;
  maps.color[size + i] = pixel.color.y;
  maps.color[2 * size + i] = pixel.color.z;
  maps.transmittance[i] = pixel.transmittance;
  maps.last[i] = last;
  if constexpr (C::kForeground) maps.foreground[i] = pixel.foreground;
  if constexpr (C::kGeometry) {
    maps.weight[i] = pixel.weight;
    maps.depth[i] = pixel.depth;
    maps.normal[i] = pixel.normal.x;
    maps.normal[size + i] = pixel.normal.y;
    maps.normal[2 * size + i] = pixel.normal.z;
    maps.median_depth[i] = pixel.median_depth;
    maps.distortion[i] = pixel.distortion;
    maps.m1[i] = pixel.m1;
    maps.m2[i] = pixel.m2;
  }
}

__global__ __launch_bounds__(kDrawThreads) void PeakWeightsKernel(RenderInput in, uint32_t* peak_bits,
                                                                  float* alpha) {
  using C = Channels<false, false>;
  __shared__ SplatGroup groups[kDrawThreads / 32];
  __shared__ uint32_t all_peaks[kDrawThreads / 32][kGroup];  // of the group's splats, as bits.
  SplatGroup& group = groups[threadIdx.x / 32];
  uint32_t* const peaks = all_peaks[threadIdx.x / 32];
  const int lane = static_cast<int>(threadIdx.x) % 32;
  peaks[lane] = 0;
  __syncwarp();
  Pixel<float> pixel = EmptyPixel<float>();
  const auto add = [&](const Splat<float>& splat, const PixelHit<float>& hit, int slot) {
    const float weight = hit.alpha * pixel.transmittance;
    if (!AddHit<C>(splat, hit, in.near_depth, &pixel)) return false;
    // Floats that are not negative are ordered as their bits.
    atomicMax(peaks + slot, __float_as_uint(weight));
    return true;
  };
  const auto finish_group = [&](int count) {
    if (lane < count && peaks[lane] > 0) atomicMax(peak_bits + group.id[lane], peaks[lane]);
    peaks[lane] = 0;
    __syncwarp();
  };
  const WarpPixel where = FindWarpPixel(in);
  DrawPixel<C>(in, where, &group, add, finish_group);
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

void RenderForward(const RenderInput& input, RenderChannels channels, const Maps& maps, cudaStream_t stream) {
  const auto run = [&](auto of) {
    RenderForwardKernel<decltype(of)><<<DrawGrid(input), kDrawThreads, 0, stream>>>(input, maps);
  };
  if (channels.geometry) {
    channels.foreground ? run(Channels<true, true>()) : run(Channels<true, false>());
  } else {
    channels.foreground ? run(Channels<false, true>()) : run(Channels<false, false>());
  }
  CheckCuda(cudaGetLastError(), "drawing");
}

}  // namespace s2gs::cuda
