#include "s2gs/core/cuda.h"
#include "s2gs/cuda/project.h"
#include "s2gs/cuda/tiles.cuh"
#include "s2gs/kernel/sh.h"

namespace s2gs::cuda {
namespace {

constexpr int kThreads = 128;

// Surfel, footprint, bounds and colour of one Gaussian. False when it is not drawn.
__device__ bool ProjectOne(const Planes& parameters, int i, const ProjectOptions& options,
                           Splat<float>* splat, PixelRect* rect) {
  const SurfelParameters<float> g = LoadSurfel(parameters, i);
  Surfel<float> surfel;
  if (!TransformSurfel(g, options.camera, options.rule, &surfel)) return false;
  const bool is_foreground = IsForeground(g.foreground_logit, options.rule);
  const auto at = [&](int plane) { return parameters.data[plane * parameters.stride + i]; };
  const Vec3<float> dc = {at(kShDc), at(kShDc + 1), at(kShDc + 2)};
  const Vec3<float> base_color = ShBaseColor(dc);
  if (!IsSelected(options.selection, g.centre, base_color, is_foreground)) return false;
  if (!ComputeFootprint(surfel, options.camera, &splat->footprint)) return false;
  if (!BoundSplat(surfel, splat->footprint, options.camera, rect)) return false;
  splat->opacity = surfel.opacity;
  const bool is_rotating = CountsAsRotating(options.selection, g.centre, base_color, is_foreground);
  splat->foreground = options.hard_map ? (is_rotating ? 1.0F : 0.0F) : surfel.foreground;
  splat->color = ShColor(
      options.sh_degree, dc, [&](int k, int channel) { return at(kShRest + 3 * k + channel); },
      surfel.view_direction);
  return IsDrawableColor(splat->color);
}

__global__ __launch_bounds__(kThreads) void ProjectKernel(Planes parameters, int count,
                                                          ProjectOptions options, ProjectedSplats out) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  Splat<float> splat{};
  TileReach reach{};
  PixelRect rect;
  ushort4 warps{};
  if (i < count && ProjectOne(parameters, i, options, &splat, &rect)) {
    reach.footprint = splat.footprint;
    reach.cutoff2 = CutoffSquaredRadius(splat.opacity);
    warps = {static_cast<uint16_t>(rect.x_begin / kWarpWidth),
             static_cast<uint16_t>(rect.y_begin / kWarpHeight),
             static_cast<uint16_t>((rect.x_end + kWarpWidth - 1) / kWarpWidth),
             static_cast<uint16_t>((rect.y_end + kWarpHeight - 1) / kWarpHeight)};
    reach.tiles = TilesOf(warps);
  }
  const int tiles = ForEachTile(reach, options.camera.width, options.camera.height, nullptr,
                                [](uint32_t /*id*/, uint64_t /*position*/, int /*tile*/) {});
  if (i >= count) return;
  out.ids[i] = static_cast<uint32_t>(i);
  out.tile_counts[i] = static_cast<uint32_t>(tiles);
  out.depth_keys[i] = tiles > 0 ? __float_as_uint(splat.footprint.depth) : kNotDrawn;
  if (tiles > 0) {
    out.splats[i] = Pack(splat);
    out.normal_z[i] = splat.footprint.normal.z;
    out.rects[i] = warps;
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
