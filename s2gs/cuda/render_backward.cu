#include "s2gs/core/cuda.h"
#include "s2gs/cuda/render.h"
#include "s2gs/cuda/render_tile.cuh"

namespace s2gs::cuda {
namespace {

// One step of WarpSum16: lanes that differ in bit kOffset share out 2 kHalf values between them.
template <int kHalf, int kOffset>
__device__ void ShareOut(float (&v)[kPackedFloats]) {
  const bool is_upper = (threadIdx.x & kOffset) != 0;
#pragma unroll
  for (int i = 0; i < kHalf; ++i) {
    const float sent = is_upper ? v[i] : v[i + kHalf];
    const float kept = is_upper ? v[i + kHalf] : v[i];
    v[i] = kept + __shfl_xor_sync(0xFFFFFFFFU, sent, kOffset);
  }
}

// Sums 16 values over the warp in 16 shuffles: each step halves the number of values that a lane is in charge
// of. On return, lane l holds the sum of value (l / 2).
__device__ float WarpSum16(float (&v)[kPackedFloats]) {
  ShareOut<8, 16>(v);
  ShareOut<4, 8>(v);
  ShareOut<2, 4>(v);
  ShareOut<1, 2>(v);
  return v[0] + __shfl_xor_sync(0xFFFFFFFFU, v[0], 1);
}

template <typename C>
__global__ __launch_bounds__(kDrawThreads) void RenderBackwardKernel(RenderInput in, Maps maps,
                                                                     MapGradients d_maps,
                                                                     Vec3<float> background, float* d_splats,
                                                                     float* d_normal_z) {
  __shared__ SplatBatch batch;
  __shared__ uint32_t block_last;
  const TilePixel where = FindTilePixel(in.width, in.height);
  const float pixel_x = static_cast<float>(where.x) + 0.5F, pixel_y = static_cast<float>(where.y) + 0.5F;
  const int tile = static_cast<int>(blockIdx.y * gridDim.x + blockIdx.x);
  const uint32_t begin = in.tiles.begin[tile];
  const size_t size = static_cast<size_t>(in.width) * in.height;
  const size_t at = static_cast<size_t>(where.y) * in.width + where.x;
  const unsigned lane = threadIdx.x % 32;

  PixelGradient<float> d{};
  PixelAdjoint<float> state{};
  uint32_t last = 0;
  if (where.is_inside) {
    last = maps.last[at];
    Pixel<float> pixel = EmptyPixel<float>();
    pixel.transmittance = maps.transmittance[at];
    d.color = {d_maps.color[at], d_maps.color[size + at], d_maps.color[2 * size + at]};
    if constexpr (C::kForeground) d.foreground = d_maps.foreground[at];
    if constexpr (C::kGeometry) {
      d.alpha = d_maps.alpha[at];
      d.normal = {d_maps.normal[at], d_maps.normal[size + at], d_maps.normal[2 * size + at]};
      d.expected_depth = d_maps.expected_depth[at];
      d.distortion = d_maps.distortion[at];
      pixel.depth = maps.depth[at];
      pixel.m1 = maps.m1[at];
      pixel.m2 = maps.m2[at];
    }
    state = BeginPixelAdjoint<C>(pixel, d, background);
  }
  if (threadIdx.x == 0) block_last = 0;
  __syncthreads();
  const uint32_t warp_last = __reduce_max_sync(0xFFFFFFFFU, last);
  if (lane == 0) atomicMax(&block_last, warp_last);
  __syncthreads();

  // Batches from the back; slot 0 is the hindmost of its batch.
  for (uint32_t left = block_last; left > 0;) {
    const int count = static_cast<int>(min(left, static_cast<uint32_t>(kDrawThreads)));
    __syncthreads();
    if (static_cast<int>(threadIdx.x) < count) {
      batch.Load(static_cast<int>(threadIdx.x), in.splats, in.tiles.ids[begin + left - 1 - threadIdx.x],
                 C::kGeometry);
    }
    __syncthreads();
    for (int group = 0; group < count; group += 32) {
      // The group's foremost splat is number left - 1 - min(group + 31, count - 1).
      const auto foremost = left - 1 - static_cast<uint32_t>(min(group + 31, count - 1));
      if (foremost >= warp_last) continue;
      unsigned reaching = batch.Reaching(group, count, where);
      while (reaching != 0) {
        const int slot = group + __ffs(static_cast<int>(reaching)) - 1;
        reaching &= reaching - 1;
        const uint32_t number = left - 1 - static_cast<uint32_t>(slot);
        const Splat<float> splat = batch.At<C>(slot);
        PixelHit<float> hit;
        const bool is_hit =
            number < last && HitSplat(splat.footprint, splat.opacity, pixel_x, pixel_y, in.near_depth, &hit);
        if (!__any_sync(0xFFFFFFFFU, is_hit)) continue;
        Splat<float> d_splat{};
        if (is_hit) UndoHit<C>(splat, hit, d, in.near_depth, &state, &d_splat);
        const Footprint<float>& f = d_splat.footprint;
        float values[kPackedFloats] = {f.centre.x,
                                       f.centre.y,
                                       f.u.x,
                                       f.u.y,
                                       f.v.x,
                                       f.v.y,
                                       f.w.x,
                                       f.w.y,
                                       d_splat.opacity,
                                       d_splat.color.x,
                                       d_splat.color.y,
                                       d_splat.color.z,
                                       d_splat.foreground,
                                       f.depth,
                                       f.normal.x,
                                       f.normal.y};
        const float sum = WarpSum16(values);
        const uint32_t id = batch.id[slot];
        constexpr unsigned kUsed = C::kGeometry ? 16 : C::kForeground ? 13 : 12;
        if (lane % 2 == 0 && lane / 2 < kUsed) {
          atomicAdd(d_splats + static_cast<size_t>(id) * kPackedFloats + lane / 2, sum);
        }
        if constexpr (C::kGeometry) {
          const float normal_z = WarpSum(f.normal.z);
          if (lane == 1) atomicAdd(d_normal_z + id, normal_z);
        }
      }
    }
    left -= static_cast<uint32_t>(count);
  }
}

}  // namespace

void RenderBackward(const RenderInput& input, RenderChannels channels, const Maps& maps,
                    const MapGradients& gradients, const Vec3<float>& background, float* d_splats,
                    float* d_normal_z, cudaStream_t stream) {
  const dim3 grid(NumTiles(input.width), NumTiles(input.height), kDrawBlocks);
  const auto run = [&](auto of) {
    RenderBackwardKernel<decltype(of)>
        <<<grid, kDrawThreads, 0, stream>>>(input, maps, gradients, background, d_splats, d_normal_z);
  };
  if (channels.geometry) {
    channels.foreground ? run(Channels<true, true>()) : run(Channels<true, false>());
  } else {
    channels.foreground ? run(Channels<false, true>()) : run(Channels<false, false>());
  }
  CheckCuda(cudaGetLastError(), "differentiating");
}

}  // namespace s2gs::cuda
