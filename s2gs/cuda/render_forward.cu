#include "s2gs/core/cuda.h"
#include "s2gs/cuda/render.h"
#include "s2gs/cuda/render_tile.cuh"

namespace s2gs::cuda {
namespace {

template <typename C>
__global__ __launch_bounds__(kDrawThreads) void RenderForwardKernel(RenderInput in, Maps maps) {
  __shared__ SplatBatch batch;
  const TilePixel where = FindTilePixel(in.width, in.height);
  const float pixel_x = static_cast<float>(where.x) + 0.5F, pixel_y = static_cast<float>(where.y) + 0.5F;
  const int tile = static_cast<int>(blockIdx.y * gridDim.x + blockIdx.x);
  const uint32_t begin = in.tiles.begin[tile], end = in.tiles.end[tile];

  Pixel<float> pixel = EmptyPixel<float>();
  bool is_done = !where.is_inside;
  uint32_t last = 0;
  for (uint32_t first = begin; first < end; first += kDrawThreads) {
    if (__syncthreads_and(is_done) != 0) break;
    const int count = static_cast<int>(min(end - first, static_cast<uint32_t>(kDrawThreads)));
    if (static_cast<int>(threadIdx.x) < count) {
      batch.Load(static_cast<int>(threadIdx.x), in.splats, in.tiles.ids[first + threadIdx.x], C::kGeometry);
    }
    __syncthreads();
    for (int group = 0; group < count; group += 32) {
      if (__all_sync(0xFFFFFFFFU, is_done)) break;
      unsigned reaching = batch.Reaching(group, count, where);
      while (reaching != 0) {
        const int slot = group + __ffs(static_cast<int>(reaching)) - 1;
        reaching &= reaching - 1;
        if (is_done) continue;
        const Splat<float> splat = batch.At<C>(slot);
        PixelHit<float> hit;
        if (!HitSplat(splat.footprint, splat.opacity, pixel_x, pixel_y, in.near_depth, &hit)) continue;
        if (AddHit<C>(splat, hit, in.near_depth, &pixel)) {
          last = first - begin + static_cast<uint32_t>(slot) + 1;
        } else {
          is_done = true;
        }
      }
    }
  }

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

// The loop of RenderForwardKernel, for the weights alone.
__global__ __launch_bounds__(kDrawThreads) void PeakWeightsKernel(RenderInput in, uint32_t* peak_bits) {
  __shared__ SplatBatch batch;
  using C = Channels<false, false>;
  const TilePixel where = FindTilePixel(in.width, in.height);
  const float pixel_x = static_cast<float>(where.x) + 0.5F, pixel_y = static_cast<float>(where.y) + 0.5F;
  const int tile = static_cast<int>(blockIdx.y * gridDim.x + blockIdx.x);
  const uint32_t begin = in.tiles.begin[tile], end = in.tiles.end[tile];
  Pixel<float> pixel = EmptyPixel<float>();
  bool is_done = !where.is_inside;
  for (uint32_t first = begin; first < end; first += kDrawThreads) {
    if (__syncthreads_and(is_done) != 0) break;
    const int count = static_cast<int>(min(end - first, static_cast<uint32_t>(kDrawThreads)));
    if (static_cast<int>(threadIdx.x) < count) {
      batch.Load(static_cast<int>(threadIdx.x), in.splats, in.tiles.ids[first + threadIdx.x], false);
    }
    __syncthreads();
    for (int slot = 0; slot < count; ++slot) {
      const Splat<float> splat = batch.At<C>(slot);
      PixelHit<float> hit;
      float weight = 0;
      if (!is_done && HitSplat(splat.footprint, splat.opacity, pixel_x, pixel_y, in.near_depth, &hit)) {
        weight = hit.alpha * pixel.transmittance;
        if (!AddHit<C>(splat, hit, in.near_depth, &pixel)) {
          is_done = true;
          weight = 0;
        }
      }
      // Floats that are not negative are ordered as their bits.
      const uint32_t largest = __reduce_max_sync(0xFFFFFFFFU, __float_as_uint(weight));
      if (threadIdx.x % 32 == 0 && largest > 0) atomicMax(peak_bits + batch.id[slot], largest);
    }
  }
}

}  // namespace

void RenderPeakWeights(const RenderInput& input, float* peak_weights, cudaStream_t stream) {
  const dim3 grid(NumTiles(input.width), NumTiles(input.height), kDrawBlocks);
  PeakWeightsKernel<<<grid, kDrawThreads, 0, stream>>>(input, reinterpret_cast<uint32_t*>(peak_weights));
  CheckCuda(cudaGetLastError(), "peak weights");
}

void RenderForward(const RenderInput& input, RenderChannels channels, const Maps& maps, cudaStream_t stream) {
  const dim3 grid(NumTiles(input.width), NumTiles(input.height), kDrawBlocks);
  const auto run = [&](auto of) {
    RenderForwardKernel<decltype(of)><<<grid, kDrawThreads, 0, stream>>>(input, maps);
  };
  if (channels.geometry) {
    channels.foreground ? run(Channels<true, true>()) : run(Channels<true, false>());
  } else {
    channels.foreground ? run(Channels<false, true>()) : run(Channels<false, false>());
  }
  CheckCuda(cudaGetLastError(), "drawing");
}

}  // namespace s2gs::cuda
