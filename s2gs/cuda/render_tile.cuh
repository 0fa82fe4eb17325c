#pragma once

#include "s2gs/cuda/device_data.h"
#include "s2gs/cuda/render.h"

namespace s2gs::cuda {

// How a view is drawn, forward and backward. A warp draws 8 x 4 pixels by itself: warps of one tile differ
// too much in work to wait for each other. It goes through the tile's list in groups of 32 splats:
//   1. each lane tests one splat against the warp's pixels; those that reach them go to shared memory;
//   2. for each of these, every lane tests its own pixel, roughly but never too strictly, and notes it;
//   3. every lane goes through its own notes: lanes work on different splats at the same time, because most
//      splats hit few of the 32 pixels.

constexpr unsigned kAllLanes = 0xFFFFFFFFU;
constexpr int kGroup = 32;

/// The pixel of the calling thread.
struct WarpPixel {
  int tile;
  int x, y;
  bool is_inside;
  float x_begin, y_begin, x_end, y_end;  ///< centres of the outermost pixels of the warp's own rectangle.
};

__device__ inline WarpPixel FindWarpPixel(const RenderInput& in) {
  const int lane = static_cast<int>(threadIdx.x) % 32;
  const int warp = static_cast<int>((blockIdx.x % kDrawBlocks) * kDrawThreads + threadIdx.x) / 32;
  WarpPixel pixel;
  pixel.tile = static_cast<int>(in.tiles.order[blockIdx.x / kDrawBlocks]);
  const int columns = NumTiles(in.width);
  const int x0 = pixel.tile % columns * kTile + warp % 2 * 8;
  const int y0 = pixel.tile / columns * kTile + warp / 2 * 4;
  pixel.x = x0 + lane % 8;
  pixel.y = y0 + lane / 8;
  pixel.is_inside = pixel.x < in.width && pixel.y < in.height;
  pixel.x_begin = static_cast<float>(x0) + 0.5F;
  pixel.y_begin = static_cast<float>(y0) + 0.5F;
  pixel.x_end = pixel.x_begin + 7;
  pixel.y_end = pixel.y_begin + 3;
  return pixel;
}

/// The splats of a group that reach the warp's pixels, in shared memory.
struct SplatGroup {
  float4 a[kGroup], b[kGroup], c[kGroup], d[kGroup];
  float normal_z[kGroup];
  float cutoff2[kGroup];
  uint32_t number[kGroup];  ///< place in the tile's list, from 0.
  uint32_t id[kGroup];

  /// Tests the lane's splat and keeps it if it reaches the warp's pixels. All lanes must call it.
  /// \return  the number of splats kept, in the order of the lanes.
  __device__ int Keep(const RenderInput& in, const WarpPixel& pixel, bool has_splat, uint32_t splat_id,
                      uint32_t its_number, bool with_normal) {
    const unsigned lane = threadIdx.x % 32;
    float4 its_a{}, its_b{}, its_c{};
    float its_cutoff2 = 0;
    bool reaches = false;
    if (has_splat) {
      const PackedSplat& splat = in.splats.splats[splat_id];
      its_a = splat.a;
      its_b = splat.b;
      its_c = splat.c;
      its_cutoff2 = CutoffSquaredRadius(its_c.x);
      reaches = ReachesRect(UnpackOutline(its_a, its_b), its_cutoff2, pixel.x_begin, pixel.y_begin,
                            pixel.x_end, pixel.y_end);
    }
    const unsigned kept = __ballot_sync(kAllLanes, reaches);
    if (reaches) {
      const int slot = __popc(kept & ((1U << lane) - 1));
      a[slot] = its_a;
      b[slot] = its_b;
      c[slot] = its_c;
      d[slot] = in.splats.splats[splat_id].d;
      if (with_normal) normal_z[slot] = in.splats.normal_z[splat_id];
      cutoff2[slot] = its_cutoff2;
      number[slot] = its_number;
      id[slot] = splat_id;
    }
    __syncwarp();
    return __popc(kept);
  }

  __device__ static Footprint<float> UnpackOutline(const float4& a, const float4& b) {
    Footprint<float> footprint;
    footprint.centre = {a.x, a.y};
    footprint.u = {a.z, a.w};
    footprint.v = {b.x, b.y};
    footprint.w = {b.z, b.w};
    return footprint;
  }

  __device__ bool MayHit(int slot, float pixel_x, float pixel_y) const {
    return MayHitSplat(UnpackOutline(a[slot], b[slot]), cutoff2[slot], pixel_x, pixel_y);
  }

  template <typename C>
  __device__ Splat<float> At(int slot) const {
    float z = 0;
    if constexpr (C::kGeometry) z = normal_z[slot];
    return Unpack(a[slot], b[slot], c[slot], d[slot], z);
  }
};

}  // namespace s2gs::cuda
