#include "s2gs/core/cuda.h"
#include "s2gs/cuda/packed_rows.cuh"
#include "s2gs/cuda/project.h"
#include "s2gs/cuda/tiles.cuh"
#include "s2gs/kernel/sh.h"

namespace s2gs::cuda {
namespace {

constexpr int kThreads = 128;

// Surfel, footprint and bounds of one Gaussian: all but its colour. False when it is not drawn.
__device__ bool PlaceOne(const Planes& parameters, int i, const ProjectOptions& options, Splat<float>* splat,
                         PixelRect* rect) {
  const SurfelParameters<float> g = LoadSurfel(parameters, i);
  Surfel<float> surfel;
  if (!TransformSurfel(g, options.camera, options.rule, &surfel)) return false;
  const bool is_foreground = IsForeground(g.foreground_logit, options.rule);
  const auto at = [&](int plane) { return parameters.data[plane * parameters.stride + i]; };
  const Vec3<float> base_color = ShBaseColor<float>({at(kShDc), at(kShDc + 1), at(kShDc + 2)});
  if (!IsSelected(options.selection, g.centre, base_color, is_foreground)) return false;
  if (!ComputeFootprint(surfel, options.camera, &splat->footprint)) return false;
  if (!BoundSplat(surfel, splat->footprint, options.camera, rect)) return false;
  splat->opacity = surfel.opacity;
  const bool is_rotating = CountsAsRotating(options.selection, g.centre, base_color, is_foreground);
  splat->foreground = options.hard_map ? (is_rotating ? 1.0F : 0.0F) : surfel.foreground;
  return true;
}

__global__ __launch_bounds__(kThreads) void ProjectKernel(Planes parameters, int count,
                                                          ProjectOptions options, ProjectedSplats out) {
  __shared__ PackedRows<kThreads> rows;
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  Splat<float> splat{};
  TileReach reach{};
  PixelRect rect;
  ushort4 warps{};
  if (i < count && PlaceOne(parameters, i, options, &splat, &rect)) {
    reach.footprint = splat.footprint;
    reach.cutoff2 = CutoffSquaredRadius(splat.opacity);
    warps = {static_cast<uint16_t>(rect.x_begin / kWarpWidth),
             static_cast<uint16_t>(rect.y_begin / kWarpHeight),
             static_cast<uint16_t>((rect.x_end + kWarpWidth - 1) / kWarpWidth),
             static_cast<uint16_t>((rect.y_end + kWarpHeight - 1) / kWarpHeight)};
    reach.tiles = TilesOf(warps);
  }
  uint32_t mask = 0;
  const int tiles = ForEachTile(reach, options.camera.width, options.camera.height, nullptr, &mask,
                                [](uint32_t /*id*/, uint64_t /*position*/, int /*tile*/) {});
  const unsigned drawn = __ballot_sync(0xFFFFFFFFU, tiles > 0);
  rows.Put(Pack(splat));
  const auto warp_begin = static_cast<size_t>(i) - threadIdx.x % 32;
  // Opacity and colour are written beside (colors.h).
  rows.Store(reinterpret_cast<float4*>(out.splats + warp_begin), drawn, 0b1011);
  if (i >= count) return;
  out.ids[i] = static_cast<uint32_t>(i);
  out.tile_counts[i] = static_cast<uint32_t>(tiles);
  out.depth_keys[i] = tiles > 0 ? DepthKey(splat.footprint.depth, options.camera.near_depth) : kNotDrawn;
  if (tiles > 0) {
    out.normal_z[i] = splat.footprint.normal.z;
    out.rects[i] = warps;
    out.tile_masks[i] = mask;
    out.cutoffs[i] = reach.cutoff2;
  }
}

}  // namespace

void Project(const Planes& parameters, int64_t count, const ProjectOptions& options,
             const ProjectedSplats& splats, cudaStream_t stream) {
  if (count == 0) return;
  ProjectKernel<<<NumBlocks(count, kThreads), kThreads, 0, stream>>>(parameters, static_cast<int>(count),
                                                                     options, splats);
  CheckCuda(cudaGetLastError(), "projection");
}

}  // namespace s2gs::cuda
