#include "s2gs/core/cuda.h"
#include "s2gs/cuda/render.h"
#include "s2gs/cuda/render_tile.cuh"

namespace s2gs::cuda {
namespace {

// A warp goes through its list of hits from the back, in groups of up to 32 splats:
//   1. the pairs of a splat and a pixel are dealt out to the lanes, which work out alpha and dL/dw of each;
//   2. every lane goes through its own pixel's pairs in their order, which is all that needs one;
//   3. the pairs of each splat are cut into shares of kShare; every lane sums up the loss by its share's
//   splat.
// A group has as many splats as have 32 shares. The second step is short, the first has no lane idle, and in
// the third no lane works for longer than on one share: some splats hit all of the pixels, most of them few.

constexpr int kShare = 8;
constexpr int kMaxShares = (32 + kShare - 1) / kShare;  // of one splat
constexpr int kMaxPairs = 32 * kShare;                  // of a group
// Of a share's sums in shared memory; not 16, so that rows spread over the banks.
constexpr int kSumsStride = kPackedFloats + 4;

// Places of what a pixel has to say to the splats that hit it.
template <typename C>
struct PixelRow {
  static constexpr int kColor = 0;
  static constexpr int kForeground = 3;
  static constexpr int kNormal = kForeground + (C::kForeground ? 1 : 0);
  static constexpr int kByDepthSum = kNormal + 3;
  static constexpr int kDepth = kByDepthSum + 1;
  static constexpr int kDistortion = kDepth + 1;  // the loss by it, then weight, m1 and m2
  static constexpr int kCount = C::kDistortion ? kDistortion + 4 : C::kGeometry ? kDistortion : kNormal;
  static constexpr int kQuads = (kCount + 3) / 4;  // in shared memory: a row is read 16 bytes at a time
};

template <typename C>
struct BackwardScratch {
  SplatGroup group;
  uint2 pairs_of[kGroup];                // of each splat: its first pair, and its pixels
  float4 rows[PixelRow<C>::kQuads][32];  // what each pixel has to say
  union {
    float2 pairs[kMaxPairs];  // alpha and dL/dw, then weight and dL/dalpha, by splat
    float sums[kGroup][kSumsStride];
  };
  uint16_t splat_and_pixel[kMaxPairs];
  uint16_t splat_and_share[32];
};

template <typename C>
__device__ PixelAdjoint<float> LoadPixel(const RenderInput& in, const Maps& maps, const MapGradients& d_maps,
                                         const Vec3<float>& background, size_t at, PixelGradient<float>* d) {
  const size_t size = static_cast<size_t>(in.width) * in.height;
  Pixel<float> pixel = EmptyPixel<float>();
  pixel.transmittance = maps.transmittance[at];
  d->color = {d_maps.color[at], d_maps.color[size + at], d_maps.color[2 * size + at]};
  if constexpr (C::kForeground) d->foreground = d_maps.foreground[at];
  if constexpr (C::kGeometry) {
    d->alpha = d_maps.alpha[at];
    d->normal = {d_maps.normal[at], d_maps.normal[size + at], d_maps.normal[2 * size + at]};
    d->expected_depth = d_maps.expected_depth[at];
    pixel.weight = maps.weight[at];
    pixel.depth = maps.depth[at];
  }
  if constexpr (C::kDistortion) {
    d->distortion = d_maps.distortion[at];
    pixel.m1 = maps.m1[at];
    pixel.m2 = maps.m2[at];
  }
  return BeginPixelAdjoint<C>(pixel, *d, background);
}

template <typename C>
__device__ void StoreRow(const PixelGradient<float>& d, const PixelTotals<float>& totals, unsigned pixel,
                         float4 (*rows)[32]) {
  using Row = PixelRow<C>;
  float values[4 * Row::kQuads] = {};
  values[Row::kColor] = d.color.x;
  values[Row::kColor + 1] = d.color.y;
  values[Row::kColor + 2] = d.color.z;
  if constexpr (C::kForeground) values[Row::kForeground] = d.foreground;
  if constexpr (C::kGeometry) {
    values[Row::kNormal] = d.normal.x;
    values[Row::kNormal + 1] = d.normal.y;
    values[Row::kNormal + 2] = d.normal.z;
    values[Row::kByDepthSum] = totals.by_depth_sum;
    values[Row::kDepth] = totals.depth;
  }
  if constexpr (C::kDistortion) {
    values[Row::kDistortion] = d.distortion;
    values[Row::kDistortion + 1] = totals.weight;
    values[Row::kDistortion + 2] = totals.m1;
    values[Row::kDistortion + 3] = totals.m2;
  }
#pragma unroll
  for (int quad = 0; quad < Row::kQuads; ++quad) {
    const float* const v = values + 4 * quad;
    rows[quad][pixel] = {v[0], v[1], v[2], v[3]};
  }
}

template <typename C>
__device__ void ReadRow(const float4 (*rows)[32], unsigned pixel, PixelGradient<float>* d,
                        PixelTotals<float>* totals) {
  using Row = PixelRow<C>;
  float values[4 * Row::kQuads];
#pragma unroll
  for (int quad = 0; quad < Row::kQuads; ++quad) {
    const float4 v = rows[quad][pixel];
    values[4 * quad] = v.x;
    values[4 * quad + 1] = v.y;
    values[4 * quad + 2] = v.z;
    values[4 * quad + 3] = v.w;
  }
  d->color = {values[Row::kColor], values[Row::kColor + 1], values[Row::kColor + 2]};
  if constexpr (C::kForeground) d->foreground = values[Row::kForeground];
  if constexpr (C::kGeometry) {
    d->normal = {values[Row::kNormal], values[Row::kNormal + 1], values[Row::kNormal + 2]};
    totals->by_depth_sum = values[Row::kByDepthSum];
    totals->depth = values[Row::kDepth];
  }
  if constexpr (C::kDistortion) {
    d->distortion = values[Row::kDistortion];
    totals->weight = values[Row::kDistortion + 1];
    totals->m1 = values[Row::kDistortion + 2];
    totals->m2 = values[Row::kDistortion + 3];
  }
}

// How a warp's pixel is hit by a splat that was added to it.
__device__ PixelHit<float> HitOf(const Splat<float>& splat, const WarpPixel& where, unsigned pixel,
                                 float near_depth) {
  PixelHit<float> hit;
  HitSplat(splat.footprint, splat.opacity, where.x_begin + static_cast<float>(pixel % kWarpWidth),
           where.y_begin + static_cast<float>(pixel / kWarpWidth), near_depth, &hit);
  return hit;
}

__device__ void AddFour(float* to, const float4& values) {
#if __CUDA_ARCH__ >= 900
  atomicAdd(reinterpret_cast<float4*>(to), values);
#else
  atomicAdd(to, values.x);
  atomicAdd(to + 1, values.y);
  atomicAdd(to + 2, values.z);
  atomicAdd(to + 3, values.w);
#endif
}

// Adds the sums of each splat's shares to global memory: four lanes a splat, four values a lane.
// \param own_shares  of the lane's splat: the first, and how many.
template <typename C>
__device__ void FlushSums(const float (*sums)[kSumsStride], unsigned num_splats, uint32_t own_id,
                          ushort2 own_shares, float* d_splats) {
  constexpr unsigned kParts = kPackedFloats / 4, kAtOnce = 32 / kParts;
  constexpr unsigned kUsed = C::kGeometry || C::kForeground ? kParts : kParts - 1;
  const unsigned lane = threadIdx.x % 32;
  const unsigned part = lane % kParts;
  const unsigned packed_shares = own_shares.x | own_shares.y << 16U;
  for (unsigned first = 0; first < num_splats; first += kAtOnce) {
    const unsigned slot = first + lane / kParts;
    const uint32_t id = __shfl_sync(kAllLanes, own_id, slot);
    const unsigned shares = __shfl_sync(kAllLanes, packed_shares, slot);
    if (slot >= num_splats || part >= kUsed) continue;
    float4 sum = {0, 0, 0, 0};
    for (unsigned i = 0; i < shares >> 16U; ++i) {
      const float4 more = reinterpret_cast<const float4*>(sums[(shares & 0xFFFFU) + i])[part];
      sum = {sum.x + more.x, sum.y + more.y, sum.z + more.z, sum.w + more.w};
    }
    AddFour(d_splats + static_cast<size_t>(id) * kPackedFloats + 4 * part, sum);
  }
}

template <typename C>
__global__ __launch_bounds__(kDrawThreads) void RenderBackwardKernel(RenderInput in, Maps maps,
                                                                     HitLists lists, MapGradients d_maps,
                                                                     Vec3<float> background, float* d_splats,
                                                                     float* d_normal_z) {
  __shared__ BackwardScratch<C> scratches[kDrawThreads / 32];
  BackwardScratch<C>& scratch = scratches[threadIdx.x / 32];
  const WarpPixel where = FindWarpPixel(in);
  const unsigned lane = threadIdx.x % 32;
  const unsigned lanes_before = (1U << lane) - 1;
  const WarpHit* const all_hits = HitsOf(in, lists, where);
  uint32_t left = HitCountOf(lists, where);

  PixelAdjoint<float> state{};
  {
    PixelGradient<float> d{};
    if (where.is_inside && left > 0) {
      const size_t at = static_cast<size_t>(where.y) * in.width + where.x;
      state = LoadPixel<C>(in, maps, d_maps, background, at, &d);
    }
    StoreRow<C>(d, state.totals, lane, scratch.rows);
  }

  while (left > 0) {
    // Lane 0 takes the hindmost splat.
    WarpHit own{};
    if (lane < left) own = all_hits[left - 1 - lane];
    const auto num_pairs = static_cast<unsigned>(__popc(own.pixels));
    const unsigned num_shares = (num_pairs + kShare - 1) / kShare;
    // Pairs and, in the upper half, shares of the splats before this one and of itself.
    unsigned end = num_pairs | num_shares << 16U;
    for (unsigned step = 1; step < 32; step *= 2) {
      const unsigned before = __shfl_up_sync(kAllLanes, end, step);
      if (lane >= step) end += before;
    }
    const bool is_taken = num_pairs > 0 && end >> 16U <= 32;
    const unsigned taken = __ballot_sync(kAllLanes, is_taken);
    const auto num_splats = static_cast<unsigned>(__popc(taken));
    const unsigned all = __shfl_sync(kAllLanes, end, num_splats - 1);
    left -= num_splats;
    const unsigned pixels = is_taken ? own.pixels : 0;
    const unsigned first_pair = (end & 0xFFFFU) - num_pairs, first_share = (end >> 16U) - num_shares;
    scratch.pairs_of[lane] = make_uint2(first_pair, pixels);
    scratch.group.Load(in.splats, own.id, taken, C::kGeometry);
    if (is_taken) {
      for (unsigned i = 0; i < num_shares; ++i) {
        scratch.splat_and_share[first_share + i] = static_cast<uint16_t>(lane * kMaxShares + i);
      }
    }
    // A lane lists its own pixel's pairs: pixels have about as many each, splats have not.
    const unsigned hits = Transpose(pixels);
    __syncwarp();
    const auto place_of = [&](unsigned slot) {
      const uint2 its = scratch.pairs_of[slot];
      return its.x + __popc(its.y & lanes_before);
    };
    for (unsigned rest = hits; rest != 0; rest &= rest - 1) {
      const unsigned slot = __ffs(static_cast<int>(rest)) - 1;
      scratch.splat_and_pixel[place_of(slot)] = static_cast<uint16_t>(slot * 32 + lane);
    }
    scratch.group.Wait();

    for (unsigned i = lane; i < (all & 0xFFFFU); i += 32) {
      const unsigned slot = scratch.splat_and_pixel[i] / 32U, pixel = scratch.splat_and_pixel[i] % 32U;
      const Splat<float> splat = scratch.group.template At<C>(slot);
      const PixelHit<float> hit = HitOf(splat, where, pixel, in.near_depth);
      PixelGradient<float> d;
      PixelTotals<float> totals;
      ReadRow<C>(scratch.rows, pixel, &d, &totals);
      scratch.pairs[i] = {hit.alpha, LossByWeight<C>(splat, hit.depth, d, totals, in.near_depth)};
    }
    __syncwarp();

    for (unsigned rest = hits; rest != 0; rest &= rest - 1) {
      float2* const pair = scratch.pairs + place_of(__ffs(static_cast<int>(rest)) - 1);
      const HitAdjoint<float> by_hit = UndoWeight(pair->x, pair->y, &state);
      *pair = {by_hit.weight, by_hit.d_alpha};
    }
    __syncwarp();

    Splat<float> sum{};
    if (lane < all >> 16U) {
      const unsigned slot = scratch.splat_and_share[lane] / kMaxShares;
      const unsigned first = scratch.splat_and_share[lane] % kMaxShares * kShare;
      const uint2 its = scratch.pairs_of[slot];
      const auto count = static_cast<unsigned>(__popc(its.y));
      const unsigned begin = its.x + first, share_end = begin + min(count - first, kShare);
      const Splat<float> splat = scratch.group.template At<C>(slot);
      for (unsigned i = begin; i < share_end; ++i) {
        const unsigned pixel = scratch.splat_and_pixel[i] % 32U;
        const PixelHit<float> hit = HitOf(splat, where, pixel, in.near_depth);
        PixelGradient<float> d;
        PixelTotals<float> totals;
        ReadRow<C>(scratch.rows, pixel, &d, &totals);
        const float2 pair = scratch.pairs[i];
        AddSplatAdjoint<C>(splat, hit, {pair.x, pair.y}, d, totals, in.near_depth, &sum);
      }
    }
    __syncwarp();
    const PackedSplat packed = Pack(sum);
    float4* const row = reinterpret_cast<float4*>(scratch.sums[lane]);
    row[0] = packed.a;
    row[1] = packed.b;
    row[2] = packed.c;
    row[3] = packed.d;
    if constexpr (C::kGeometry) scratch.sums[lane][kPackedFloats] = sum.footprint.normal.z;
    __syncwarp();
    FlushSums<C>(scratch.sums, num_splats, own.id,
                 make_ushort2(static_cast<uint16_t>(first_share), static_cast<uint16_t>(num_shares)),
                 d_splats);
    if constexpr (C::kGeometry) {
      if (is_taken) {
        float normal_z = 0;
        for (unsigned i = 0; i < num_shares; ++i) normal_z += scratch.sums[first_share + i][kPackedFloats];
        atomicAdd(d_normal_z + own.id, normal_z);
      }
    }
    __syncwarp();
  }
}

}  // namespace

void RenderBackward(const RenderInput& input, RenderChannels channels, const Maps& maps,
                    const HitLists& lists, const MapGradients& gradients, const Vec3<float>& background,
                    float* d_splats, float* d_normal_z, cudaStream_t stream) {
  const auto grid = static_cast<unsigned>(NumTiles(input.width) * NumTiles(input.height) * kDrawBlocks);
  WithChannels(channels, [&](auto of) {
    RenderBackwardKernel<decltype(of)>
        <<<grid, kDrawThreads, 0, stream>>>(input, maps, lists, gradients, background, d_splats, d_normal_z);
  });
  CheckCuda(cudaGetLastError(), "differentiating");
}

}  // namespace s2gs::cuda
