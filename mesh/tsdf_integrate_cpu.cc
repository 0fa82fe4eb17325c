#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <memory>
#include <string>
#include <vector>

#include "mesh/tsdf_integrate.h"

// The kernel is compiled for several instruction sets in one file, with attributes instead of compiler flags:
// functions of the standard library that are instantiated here stay free of what other processors lack.
#define S2GS_INLINE __attribute__((always_inline)) inline

namespace s2gs {
namespace {

constexpr int kSlice = kBlockSide * kBlockSide;
constexpr int kTile = 16;  // [px]

// The greatest depth at which a view still says something, for tiles of its map.
struct DepthTiles {
  int columns = 0;
  int rows = 0;
  std::vector<float> far;
  float far_outside_map = 0;
};

DepthTiles MakeTiles(const TsdfView& view, double truncation) {
  constexpr float kInfinite = std::numeric_limits<float>::infinity();
  DepthTiles tiles;
  tiles.columns = (view.map_width + kTile - 1) / kTile;
  tiles.rows = (view.map_height + kTile - 1) / kTile;
  tiles.far.assign(static_cast<size_t>(tiles.columns) * tiles.rows, 0);
  tiles.far_outside_map = view.planes[kOutsideMap].weight < 0 ? kInfinite : 0;
  // SampleView's own limit is twice the truncation. Inside a steep pixel the depth varies by some pixels.
  const double behind = 2.01 * truncation;
  const double slope = 1 + 8 / std::min(view.camera.fx, view.camera.fy);
  for (int row = 0; row < view.map_height; ++row) {
    const PixelPlane* planes = &view.planes[kFirstPixel + static_cast<size_t>(row) * view.map_width];
    float* far_row = &tiles.far[static_cast<size_t>(row / kTile) * tiles.columns];
    for (int column = 0; column < view.map_width; ++column) {
      const PixelPlane& plane = planes[column];
      if (plane.weight == 0) continue;
      float far = kInfinite;
      if (plane.weight > 0) {
        const Eigen::Vector3d ray = view.Ray(column, row);
        const double inverse_depth = plane.a * ray.x() + plane.b * ray.y() + plane.c;
        if (inverse_depth > 0) far = static_cast<float>(slope / inverse_depth + behind);
      }
      far_row[column / kTile] = std::max(far_row[column / kTile], far);
    }
  }
  return tiles;
}

// Whether any voxel of a block can learn something from the view.
bool MayMatter(const TsdfViewParams& view, const DepthTiles& tiles, const float* first_voxel, float radius) {
  float middle[3];
  for (int i = 0; i < 3; ++i) {
    const double* row = view.rotation + 3 * i;
    middle[i] = first_voxel[i] + static_cast<float>((kBlockSide - 1) * 0.5 * (row[0] + row[1] + row[2]));
  }
  const float near = middle[2] - radius;
  const float far = middle[2] + radius;
  if (far <= 0) return false;
  if (near <= 0.01F * far) return true;
  const auto low = [&](float x, float f, float c) {
    const float edge = x - radius;
    return f * edge / (edge > 0 ? far : near) + c - 1;
  };
  const auto high = [&](float x, float f, float c) {
    const float edge = x + radius;
    return f * edge / (edge > 0 ? near : far) + c + 1;
  };
  const float u0 = low(middle[0], view.fx, view.cx);
  const float u1 = high(middle[0], view.fx, view.cx);
  const float v0 = low(middle[1], view.fy, view.cy);
  const float v1 = high(middle[1], view.fy, view.cy);
  if (u1 < 0 || v1 < 0 || u0 >= view.width || v0 >= view.height) return false;
  const float map_u0 = u0 - view.map_x;
  const float map_u1 = u1 - view.map_x;
  const float map_v0 = v0 - view.map_y;
  const float map_v1 = v1 - view.map_y;
  const bool leaves_map = map_u0 < 0 || map_v0 < 0 || map_u1 >= view.map_width || map_v1 >= view.map_height;
  if (leaves_map && tiles.far_outside_map > 0) return true;
  if (map_u1 < 0 || map_v1 < 0 || map_u0 >= view.map_width || map_v0 >= view.map_height) return false;
  const auto tile = [](float position, int count) {
    return std::clamp(static_cast<int>(position / kTile), 0, count - 1);
  };
  const int column1 = tile(map_u1, tiles.columns);
  const int row1 = tile(map_v1, tiles.rows);
  for (int row = tile(map_v0, tiles.rows); row <= row1; ++row) {
    for (int column = tile(map_u0, tiles.columns); column <= column1; ++column) {
      if (tiles.far[static_cast<size_t>(row) * tiles.columns + column] >= near) return true;
    }
  }
  return false;
}

// Adds one view to one block.
S2GS_INLINE void AddToBlock(const TsdfViewParams& view, const TsdfVoxelParams& params,
                            const float* first_voxel, float* sums, float* weights) {
  float rotation[9];
  for (int i = 0; i < 9; ++i) rotation[i] = static_cast<float>(view.rotation[i]);
  for (int slice = 0; slice < kBlockSide; ++slice) {
    alignas(64) float x[kSlice];
    alignas(64) float y[kSlice];
    alignas(64) float z[kSlice];
    alignas(64) int32_t index[kSlice];
    int any_index = 0;
#pragma omp simd reduction(| : any_index)
    for (int i = 0; i < kSlice; ++i) {
      const auto dx = static_cast<float>(i & 7);
      const auto dy = static_cast<float>(i >> 3);
      const auto dz = static_cast<float>(slice);
      x[i] = first_voxel[0] + rotation[0] * dx + rotation[1] * dy + rotation[2] * dz;
      y[i] = first_voxel[1] + rotation[3] * dx + rotation[4] * dy + rotation[5] * dz;
      z[i] = first_voxel[2] + rotation[6] * dx + rotation[7] * dy + rotation[8] * dz;
      index[i] = PlaneIndex(view, x[i], y[i], z[i]);
      any_index |= index[i];
    }
    if (any_index == kOutsideImage) continue;
    alignas(64) float a[kSlice];
    alignas(64) float b[kSlice];
    alignas(64) float c[kSlice];
    alignas(64) float w[kSlice];
    for (int i = 0; i < kSlice; ++i) {
      const PixelPlane& plane = view.planes[index[i]];
      a[i] = plane.a;
      b[i] = plane.b;
      c[i] = plane.c;
      w[i] = plane.weight;
    }
    float* slice_sums = sums + slice * kSlice;
    float* slice_weights = weights + slice * kSlice;
#pragma omp simd
    for (int i = 0; i < kSlice; ++i) {
      const TsdfSample sample = SampleView(view, params, {a[i], b[i], c[i], w[i]}, x[i], y[i], z[i]);
      slice_sums[i] += sample.weight * sample.distance;
      slice_weights[i] += sample.weight;
    }
  }
}

using AddFunction = void (*)(const TsdfViewParams&, const TsdfVoxelParams&, const float*, float*, float*);

void AddPortable(const TsdfViewParams& view, const TsdfVoxelParams& params, const float* first_voxel,
                 float* sums, float* weights) {
  AddToBlock(view, params, first_voxel, sums, weights);
}

#if defined(__x86_64__)
__attribute__((target("avx2"))) void AddAvx2(const TsdfViewParams& view, const TsdfVoxelParams& params,
                                             const float* first_voxel, float* sums, float* weights) {
  AddToBlock(view, params, first_voxel, sums, weights);
}

__attribute__((target("avx512f,avx512vl,avx512dq,avx512bw"))) void AddAvx512(const TsdfViewParams& view,
                                                                             const TsdfVoxelParams& params,
                                                                             const float* first_voxel,
                                                                             float* sums, float* weights) {
  AddToBlock(view, params, first_voxel, sums, weights);
}
#endif

AddFunction BestAdd() {
#if defined(__x86_64__)
  if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") &&
      __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512bw")) {
    return AddAvx512;
  }
  if (__builtin_cpu_supports("avx2")) return AddAvx2;
#endif
  return AddPortable;
}

class CpuIntegrator : public TsdfIntegrator {
 public:
  CpuIntegrator(int num_threads, TsdfVolume* volume) : num_threads_(num_threads), volume_(*volume) {}

  TsdfBackend backend() const override { return TsdfBackend::kCpu; }
  std::string device() const override {
    return std::to_string(num_threads_) + (num_threads_ == 1 ? " thread" : " threads");
  }

  // Each voxel meets the views in their order, whichever thread works on it.
  void Add(const std::vector<const TsdfView*>& views) override {
    const auto num_views = static_cast<int>(views.size());
    std::vector<TsdfViewParams> params(views.size());
    std::vector<DepthTiles> tiles(views.size());
#pragma omp parallel for schedule(dynamic) num_threads(num_threads_)
    for (int i = 0; i < num_views; ++i) {
      params[i] = ViewParams(*views[i], volume_.origin, volume_.voxel_size);
      tiles[i] = MakeTiles(*views[i], volume_.truncation);
    }
    const TsdfVoxelParams voxel = {static_cast<float>(1 / volume_.voxel_size),
                                   static_cast<float>(volume_.truncation / volume_.voxel_size)};
    // A little more than the half diagonal between a block's outermost voxels.
    const auto radius = static_cast<float>((kBlockSide - 1) * 0.5 * 1.7330 * volume_.voxel_size);
    const AddFunction add = BestAdd();
    const int num_blocks = volume_.blocks.size();
#pragma omp parallel for schedule(dynamic, 16) num_threads(num_threads_)
    for (int b = 0; b < num_blocks; ++b) {
      const Eigen::Vector3i block = volume_.blocks.Block(b);
      float* sums = &volume_.distances[static_cast<size_t>(b) * kBlockVoxels];
      float* weights = &volume_.weights[static_cast<size_t>(b) * kBlockVoxels];
      for (int i = 0; i < num_views; ++i) {
        float first_voxel[3];
        BlockInCamera(params[i], block.x(), block.y(), block.z(), first_voxel);
        if (MayMatter(params[i], tiles[i], first_voxel, radius)) {
          add(params[i], voxel, first_voxel, sums, weights);
        }
      }
    }
  }

  void Finish() override {
    const auto num_voxels = static_cast<int64_t>(volume_.distances.size());
#pragma omp parallel for schedule(static) num_threads(num_threads_)
    for (int64_t i = 0; i < num_voxels; ++i) {
      if (volume_.weights[i] > 0) volume_.distances[i] /= volume_.weights[i];
    }
  }

 private:
  int num_threads_;
  TsdfVolume& volume_;
};

}  // namespace

std::unique_ptr<TsdfIntegrator> MakeCpuIntegrator(int num_threads, TsdfVolume* volume) {
  return std::make_unique<CpuIntegrator>(num_threads, volume);
}

}  // namespace s2gs
