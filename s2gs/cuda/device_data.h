#pragma once

#include <cuda_runtime.h>

#include <cstdint>

#include "s2gs/core/gaussians.h"
#include "s2gs/kernel/composite.h"

namespace s2gs::cuda {

/// Parameters lie in planes, one float of every Gaussian after the other, so that neighbouring threads read
/// neighbouring addresses. The order of the planes; SH coefficients are by coefficient, R G B within.
enum Plane {
  kCentre = 0,
  kLogScale = 3,
  kRotation = 5,
  kOpacity = 9,
  kForeground = 10,
  kShDc = 11,
  kShRest = 14,
  kNumPlanes = 14 + 3 * kShRestPerChannel,
};
static_assert(kNumPlanes == kFloatsPerGaussian);

/// Planes begin on multiples of so many floats: no line of the cache is in two planes.
constexpr size_t kPlaneAlignment = 64;
inline size_t PaddedStride(size_t count) {
  return (count + kPlaneAlignment - 1) / kPlaneAlignment * kPlaneAlignment;
}

/// Steps whose gradients by the colours are kept, to be learnt from later (ColorLog).
constexpr int kColorLogSize = 4;

/// Planes that a step's kernels hand on to each other.
enum ScratchPlane {
  kColorByDirection = 0,                   ///< R by the view direction's x, y, z; G; B
  kColorLogPlane = kColorByDirection + 9,  ///< the first of the log's, slot by slot
  kByColor = 0,                            ///< in a slot: the loss by R, G, B, from which with
  kViewDirection = kByColor + 3,           ///< the view direction that by all SH coefficients follows
  kPlanesOfSlot = kViewDirection + 3,
  kNumScratchPlanes = kColorLogPlane + kColorLogSize * kPlanesOfSlot,
};

/// What the pass back has to know of a splat's colour.
enum ColorTrait : uint8_t {
  kRedIsLit = 1,  ///< above 0, where it is cut off.
  kGreenIsLit = 2,
  kBlueIsLit = 4,
  kIsDrawable = 8,  ///< IsDrawableColor
};

/// Planes of `stride` floats each.
struct Planes {
  float* data;
  size_t stride;

  __host__ __device__ float* At(int plane) const { return data + plane * stride; }
};

/// A slot of the colours' log.
__host__ __device__ inline Planes ColorSlot(const Planes& scratch, int slot) {
  return {scratch.At(kColorLogPlane + slot * kPlanesOfSlot), scratch.stride};
}

__device__ inline SurfelParameters<float> LoadSurfel(const Planes& planes, int i) {
  const auto at = [&](int plane) { return planes.data[plane * planes.stride + i]; };
  return {{at(kCentre), at(kCentre + 1), at(kCentre + 2)},
          {at(kLogScale), at(kLogScale + 1)},
          {at(kRotation), at(kRotation + 1), at(kRotation + 2), at(kRotation + 3)},
          at(kOpacity),
          at(kForeground)};
}

/// A Splat<float> packed for loads of 16 bytes. Its gradient has the same layout as 16 floats. The normal's z
/// has an array of its own, because it is read with geometry alone.
struct alignas(16) PackedSplat {
  float4 a;  ///< centre, u
  float4 b;  ///< v, w
  float4 c;  ///< opacity, colour
  float4 d;  ///< foreground, depth, normal x, y
};
constexpr int kPackedFloats = 16;

__device__ inline PackedSplat Pack(const Splat<float>& s) {
  return {{s.footprint.centre.x, s.footprint.centre.y, s.footprint.u.x, s.footprint.u.y},
          {s.footprint.v.x, s.footprint.v.y, s.footprint.w.x, s.footprint.w.y},
          {s.opacity, s.color.x, s.color.y, s.color.z},
          {s.foreground, s.footprint.depth, s.footprint.normal.x, s.footprint.normal.y}};
}

__device__ inline Splat<float> Unpack(const float4& a, const float4& b, const float4& c, const float4& d,
                                      float normal_z) {
  Splat<float> s;
  s.footprint.centre = {a.x, a.y};
  s.footprint.u = {a.z, a.w};
  s.footprint.v = {b.x, b.y};
  s.footprint.w = {b.z, b.w};
  s.footprint.depth = d.y;
  s.footprint.normal = {d.z, d.w, normal_z};
  s.opacity = c.x;
  s.color = {c.y, c.z, c.w};
  s.foreground = d.x;
  return s;
}

/// Side of a tile [px].
constexpr int kTile = 16;
constexpr int kTileThreads = kTile * kTile;
/// What a warp draws [px].
constexpr int kWarpWidth = 8, kWarpHeight = 4;
constexpr int kTileWarps = kTileThreads / 32;
/// Threads of a block that draws. Several small blocks share a tile, because a
/// block's place is free again only when the slowest of its warps has ended.
constexpr int kDrawThreads = 64;
constexpr int kDrawBlocks = kTileThreads / kDrawThreads;

inline __host__ __device__ int NumTiles(int size) { return (size + kTile - 1) / kTile; }

constexpr int kDepthBits = 24;
constexpr uint32_t kNotDrawn = (1U << kDepthBits) - 1;  ///< the depth key of splats that are not drawn.
/// A number that orders splats as their depths do, of so few bits that one pass of the sort is saved: to two
/// parts in a million up to 65,536 near depths, and to one in 30,000 beyond.
/// \param depth  at least near_depth.
__device__ inline uint32_t DepthKey(float depth, float near_depth) {
  constexpr uint32_t kFineEnd = 16U << 23U;  // 16 octaves, in units of the last place
  constexpr int kFineShift = 4, kCoarseShift = 8;
  static_assert((kFineEnd >> kFineShift) + ((0x7F800000U - kFineEnd) >> kCoarseShift) < kNotDrawn);
  const uint32_t units = __float_as_uint(depth) - __float_as_uint(near_depth);
  return units < kFineEnd ? units >> kFineShift
                          : (kFineEnd >> kFineShift) + ((units - kFineEnd) >> kCoarseShift);
}

/// What projection leaves for every Gaussian of the model.
struct ProjectedSplats {
  PackedSplat* splats;
  float* normal_z;
  uint32_t* depth_keys;   ///< DepthKey, or kNotDrawn.
  uint32_t* ids;          ///< 0, 1, 2, ...
  uint32_t* tile_counts;  ///< 0 for splats that are not drawn.
  uint32_t* tile_masks;   ///< which tiles of the rectangle these are, where it has few (kMaskTiles).
  ushort4* rects;         ///< what it may reach: x begin, y begin, x end, y end [warps' rectangles].
  float* cutoffs;         ///< CutoffSquaredRadius of the opacity.
};

/// Maps of one view in planes of width * height pixels. Pointers of channels that are off are null.
struct Maps {
  float* color;          ///< 3 planes, without background.
  float* transmittance;  ///< final.
  float* foreground;
  float* weight;  ///< sum of w.
  float* depth;   ///< sum of w z.
  float* normal;  ///< 3 planes.
  float* median_depth;
  float* distortion;
  float* m1;
  float* m2;
};

/// The loss by the maps, of the same shape.
struct MapGradients {
  float* color;
  float* alpha;
  float* foreground;
  float* normal;
  float* expected_depth;
  float* distortion;
};

/// Splats of each tile, from front to back: tile t owns [begin[t], end[t]) of `ids`.
struct TileLists {
  const uint32_t* begin;
  const uint32_t* end;
  const uint32_t* ids;
  const uint32_t* order;  ///< all tiles, those with long lists first.
};

/// A splat that was added to pixels of a warp, a bit each.
struct alignas(8) WarpHit {
  uint32_t id;
  uint32_t pixels;
};

/// What each warp's pixels are made of, from front to back: the hits of warp w of tile t begin at
/// kTileWarps begin[t] + w (end[t] - begin[t]), and there are counts[kTileWarps t + w].
struct HitLists {
  WarpHit* hits;
  uint32_t* counts;
};

/// Sums over the steps since the losses were last taken.
struct LossSums {
  double steps;
  double total;  ///< weighted.
  double l1, dssim, normal, distortion, local_consistency, entropy_3d, entropy_2d, mask;
};

/// Written by the GPU in each step.
struct StepReport {
  uint64_t num_intersections;  ///< of splats with tiles, as many as the view has.
  uint32_t overflow;           ///< 1: more than there was room for; the step changed nothing.
};

__device__ inline float WarpSum(float value) {
  for (int offset = 16; offset > 0; offset /= 2) value += __shfl_xor_sync(0xFFFFFFFFU, value, offset);
  return value;
}

}  // namespace s2gs::cuda
