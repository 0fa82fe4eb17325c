#pragma once

#include "s2gs/cuda/device_data.h"

namespace s2gs::cuda {

/// The pixel of the calling thread.
struct TilePixel {
  int x, y;
  bool is_inside;
  float x_begin, y_begin, x_end, y_end;  ///< centres of the outermost pixels of the warp's own rectangle.
};

__device__ inline TilePixel FindTilePixel(int width, int height) {
  const int warp = static_cast<int>(blockIdx.z * kDrawThreads + threadIdx.x) / 32,
            lane = static_cast<int>(threadIdx.x) % 32;
  const int x0 = static_cast<int>(blockIdx.x) * kTile + (warp % 2) * 8;
  const int y0 = static_cast<int>(blockIdx.y) * kTile + (warp / 2) * 4;
  TilePixel pixel;
  pixel.x = x0 + lane % 8;
  pixel.y = y0 + lane / 8;
  pixel.is_inside = pixel.x < width && pixel.y < height;
  pixel.x_begin = static_cast<float>(x0) + 0.5F;
  pixel.y_begin = static_cast<float>(y0) + 0.5F;
  pixel.x_end = pixel.x_begin + 7;
  pixel.y_end = pixel.y_begin + 3;
  return pixel;
}

/// A batch of splats in shared memory.
struct SplatBatch {
  float4 a[kDrawThreads], b[kDrawThreads], c[kDrawThreads], d[kDrawThreads];
  float normal_z[kDrawThreads];
  uint32_t id[kDrawThreads];

  __device__ void Load(int slot, const ProjectedSplats& splats, uint32_t which, bool with_normal) {
    const PackedSplat& splat = splats.splats[which];
    a[slot] = splat.a;
    b[slot] = splat.b;
    c[slot] = splat.c;
    d[slot] = splat.d;
    if (with_normal) normal_z[slot] = splats.normal_z[which];
    id[slot] = which;
  }

  /// Bit i: splat first + i reaches the warp's pixels. The lanes test 32 splats at once.
  __device__ unsigned Reaching(int first, int count, const TilePixel& pixel) const {
    const int slot = first + static_cast<int>(threadIdx.x) % 32;
    bool reaches = false;
    if (slot < count) {
      Footprint<float> footprint;
      footprint.centre = {a[slot].x, a[slot].y};
      footprint.u = {a[slot].z, a[slot].w};
      footprint.v = {b[slot].x, b[slot].y};
      footprint.w = {b[slot].z, b[slot].w};
      reaches = ReachesRect(footprint, CutoffSquaredRadius(c[slot].x), pixel.x_begin, pixel.y_begin,
                            pixel.x_end, pixel.y_end);
    }
    return __ballot_sync(0xFFFFFFFFU, reaches);
  }

  template <typename C>
  __device__ Splat<float> At(int slot) const {
    float z = 0;
    if constexpr (C::kGeometry) z = normal_z[slot];
    return Unpack(a[slot], b[slot], c[slot], d[slot], z);
  }
};

}  // namespace s2gs::cuda
