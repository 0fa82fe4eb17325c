#pragma once

#include <cuda_pipeline.h>

#include "s2gs/cuda/device_data.h"
#include "s2gs/cuda/render.h"

namespace s2gs::cuda {

// How a view is drawn, forward and backward. A warp draws 8 x 4 pixels by itself: warps of one tile differ
// too much in work to wait for each other. Splats and pixels are numbered alike, from 0 to 31, so that a lane
// stands for a splat of a group at one time and for a pixel at another; which of them meet is a matrix of
// 32 x 32 bits, a row a lane, and turning it about goes from splats to pixels and back.

constexpr unsigned kAllLanes = 0xFFFFFFFFU;
constexpr int kGroup = 32;

/// The pixel of the calling thread.
struct WarpPixel {
  int tile;
  int warp;  ///< of the tile's.
  int x, y;
  bool is_inside;
  int rect_x, rect_y;      ///< the warp's rectangle, counted in such rectangles.
  float x_begin, y_begin;  ///< centre of its first pixel.
};

__device__ inline WarpPixel FindWarpPixel(const RenderInput& in) {
  const int lane = static_cast<int>(threadIdx.x) % 32;
  constexpr int kColumns = kTile / kWarpWidth;
  WarpPixel pixel;
  pixel.warp = static_cast<int>((blockIdx.x % kDrawBlocks) * kDrawThreads + threadIdx.x) / 32;
  pixel.tile = static_cast<int>(in.tiles.order[blockIdx.x / kDrawBlocks]);
  const int columns = NumTiles(in.width);
  pixel.rect_x = pixel.tile % columns * kColumns + pixel.warp % kColumns;
  pixel.rect_y = pixel.tile / columns * (kTile / kWarpHeight) + pixel.warp / kColumns;
  const int x0 = pixel.rect_x * kWarpWidth, y0 = pixel.rect_y * kWarpHeight;
  pixel.x = x0 + lane % kWarpWidth;
  pixel.y = y0 + lane / kWarpWidth;
  pixel.is_inside = pixel.x < in.width && pixel.y < in.height;
  pixel.x_begin = static_cast<float>(x0) + 0.5F;
  pixel.y_begin = static_cast<float>(y0) + 0.5F;
  return pixel;
}

/// Where the hits of a warp's pixels are listed.
__device__ inline WarpHit* HitsOf(const RenderInput& in, const HitLists& lists, const WarpPixel& where) {
  const size_t begin = in.tiles.begin[where.tile], length = in.tiles.end[where.tile] - begin;
  return lists.hits + kTileWarps * begin + where.warp * length;
}
__device__ inline uint32_t& HitCountOf(const HitLists& lists, const WarpPixel& where) {
  return lists.counts[where.tile * kTileWarps + where.warp];
}

/// Lane i's result has bit k where lane k's argument has bit i.
__device__ inline unsigned Transpose(unsigned bits) {
  const unsigned lane = threadIdx.x % 32;
  unsigned low = 0x0000FFFFU;  // columns whose number lacks the bit `step`
#pragma unroll
  for (unsigned step = 16; step > 0; step /= 2, low ^= low << step) {
    const unsigned other = __shfl_xor_sync(kAllLanes, bits, step);
    bits = (lane & step) == 0 ? (bits & low) | ((other & low) << step)
                              : (bits & ~low) | ((other & ~low) >> step);
  }
  return bits;
}

/// Splats of a group, in shared memory.
struct SplatGroup {
  float4 parts[4][kGroup];
  float normal_z[kGroup];

  /// Asks for the slots of those lanes whose bit is set, each with the splat that its lane names. Four lanes
  /// load one splat: its 64 bytes are asked for at once. All lanes must call it.
  __device__ void Load(const ProjectedSplats& splats, uint32_t id, unsigned wanted, bool with_normal) {
    const unsigned lane = threadIdx.x % 32, part = lane % 4;
#pragma unroll
    for (unsigned i = 0; i < 4; ++i) {
      const unsigned slot = 8 * i + lane / 4;
      const uint32_t its_id = __shfl_sync(kAllLanes, id, slot);
      if ((wanted >> slot & 1U) != 0) {
        const auto* source = reinterpret_cast<const float4*>(splats.splats + its_id) + part;
        __pipeline_memcpy_async(&parts[part][slot], source, sizeof(float4));
      }
    }
    if (with_normal && (wanted >> lane & 1U) != 0) {
      __pipeline_memcpy_async(&normal_z[lane], splats.normal_z + id, sizeof(float));
    }
    __pipeline_commit();
  }
  /// Returns when what Load() asked for is there, for all lanes.
  __device__ static void Wait() {
    __pipeline_wait_prior(0);
    __syncwarp();
  }

  template <typename C>
  __device__ Splat<float> At(unsigned slot) const {
    float z = 0;
    if constexpr (C::kGeometry) z = normal_z[slot];
    return Unpack(parts[0][slot], parts[1][slot], parts[2][slot], parts[3][slot], z);
  }
};

}  // namespace s2gs::cuda
