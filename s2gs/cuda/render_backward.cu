#include "s2gs/core/cuda.h"
#include "s2gs/cuda/render.h"
#include "s2gs/cuda/render_tile.cuh"

namespace s2gs::cuda {
namespace {

// Every hit writes the loss by its splat to a row of shared memory; then the rows of each splat are summed,
// and only the sums go to global memory.
constexpr int kRows = 64;  // of one warp.
static_assert(kRows >= 32, "one splat may hit all pixels of a warp");

struct HitRow {
  float4 values[kPackedFloats / 4];
  float4 normal_z;  // in x alone; a whole one keeps rows aligned and spreads them over the banks.
};
constexpr int kRowFloats = sizeof(HitRow) / sizeof(float);

__device__ void StoreRow(const Splat<float>& d, bool with_geometry, HitRow* row) {
  const PackedSplat packed = Pack(d);
  row->values[0] = packed.a;
  row->values[1] = packed.b;
  row->values[2] = packed.c;
  row->values[3] = packed.d;
  if (with_geometry) row->normal_z.x = d.footprint.normal.z;
}

struct BackwardScratch {
  SplatGroup group;
  HitRow rows[kRows];
};

template <typename C>
__global__ __launch_bounds__(kDrawThreads) void RenderBackwardKernel(RenderInput in, Maps maps,
                                                                     MapGradients d_maps,
                                                                     Vec3<float> background, float* d_splats,
                                                                     float* d_normal_z) {
  __shared__ BackwardScratch scratches[kDrawThreads / 32];
  SplatGroup& group = scratches[threadIdx.x / 32].group;
  HitRow* const rows = scratches[threadIdx.x / 32].rows;
  const WarpPixel where = FindWarpPixel(in);
  const float pixel_x = static_cast<float>(where.x) + 0.5F, pixel_y = static_cast<float>(where.y) + 0.5F;
  const uint32_t begin = in.tiles.begin[where.tile];
  const size_t size = static_cast<size_t>(in.width) * in.height;
  const size_t at = static_cast<size_t>(where.y) * in.width + where.x;
  const int lane = static_cast<int>(threadIdx.x) % 32;
  const unsigned lanes_before = (1U << lane) - 1;

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
      pixel.weight = maps.weight[at];
      pixel.depth = maps.depth[at];
      pixel.m1 = maps.m1[at];
      pixel.m2 = maps.m2[at];
    }
    state = BeginPixelAdjoint<C>(pixel, d, background);
  }

  // Groups from the back; lane 0 takes the hindmost splat.
  const uint32_t warp_last = __reduce_max_sync(kAllLanes, last);
  const auto load_id = [&](uint32_t left) {
    return static_cast<uint32_t>(lane) < left ? in.tiles.ids[begin + left - 1 - lane] : 0;
  };
  uint32_t next_id = load_id(warp_last);
  for (uint32_t left = warp_last; left > 0;) {
    const uint32_t rest = left > kGroup ? left - kGroup : 0;
    const uint32_t id = next_id;
    next_id = load_id(rest);
    const int count = group.Keep(in, where, static_cast<uint32_t>(lane) < left, id,
                                 left - 1 - static_cast<uint32_t>(lane), C::kGeometry);
    left = rest;
    for (int first = 0, end = 0; first < count; first = end) {
      // As many splats as there are rows for.
      unsigned hits = 0;           // slots that this lane's pixel may be hit by.
      unsigned lanes_of_slot = 0;  // of the slot that has this lane's number: lanes that it may hit,
      int row_of_slot = 0;         // and its first row.
      int num_rows = 0;
      for (end = first; end < count && num_rows <= kRows - 32; ++end) {
        const bool may_hit = group.number[end] < last && group.MayHit(end, pixel_x, pixel_y);
        const unsigned lanes = __ballot_sync(kAllLanes, may_hit);
        if (may_hit) hits |= 1U << end;
        if (lane == end) {
          lanes_of_slot = lanes;
          row_of_slot = num_rows;
        }
        num_rows += __popc(lanes);
      }
      if (num_rows == 0) continue;
      while (__any_sync(kAllLanes, hits != 0)) {
        const int slot = hits != 0 ? __ffs(static_cast<int>(hits)) - 1 : first;
        const unsigned lanes = __shfl_sync(kAllLanes, lanes_of_slot, slot);
        const int row = __shfl_sync(kAllLanes, row_of_slot, slot) + __popc(lanes & lanes_before);
        if (hits != 0) {
          hits &= hits - 1;
          const Splat<float> splat = group.At<C>(slot);
          Splat<float> d_splat{};
          PixelHit<float> hit;
          if (HitSplat(splat.footprint, splat.opacity, pixel_x, pixel_y, in.near_depth, &hit)) {
            UndoHit<C>(splat, hit, d, in.near_depth, &state, &d_splat);
          }
          StoreRow(d_splat, C::kGeometry, rows + row);
        }
      }
      __syncwarp();
      // Each half of the warp sums the rows of one splat, each lane one of the 16 values.
      const int value = lane % kPackedFloats;
      for (int pair = first; pair < end; pair += 2) {
        const int slot = min(pair + lane / kPackedFloats, kGroup - 1);
        const int num_hits = __popc(__shfl_sync(kAllLanes, lanes_of_slot, slot));
        const int row = __shfl_sync(kAllLanes, row_of_slot, slot);
        if (slot >= end || num_hits == 0 || pair + lane / kPackedFloats != slot) continue;
        const float* source = reinterpret_cast<const float*>(rows + row) + value;
        float sum = 0;
        for (int i = 0; i < num_hits; ++i) sum += source[i * kRowFloats];
        constexpr int kUsed = C::kGeometry ? 16 : C::kForeground ? 13 : 12;
        if (value < kUsed) {
          atomicAdd(d_splats + static_cast<size_t>(group.id[slot]) * kPackedFloats + value, sum);
        }
      }
      if constexpr (C::kGeometry) {
        // Lanes whose number is no slot of this round have no lanes noted.
        const int num_hits = __popc(lanes_of_slot);
        float sum = 0;
        for (int i = 0; i < num_hits; ++i) sum += rows[row_of_slot + i].normal_z.x;
        if (num_hits > 0) atomicAdd(d_normal_z + group.id[lane], sum);
      }
      __syncwarp();
    }
    __syncwarp();
  }
}

}  // namespace

void RenderBackward(const RenderInput& input, RenderChannels channels, const Maps& maps,
                    const MapGradients& gradients, const Vec3<float>& background, float* d_splats,
                    float* d_normal_z, cudaStream_t stream) {
  const auto grid = static_cast<unsigned>(NumTiles(input.width) * NumTiles(input.height) * kDrawBlocks);
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
