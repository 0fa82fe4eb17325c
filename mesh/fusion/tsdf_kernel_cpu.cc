#include "mesh/fusion/tsdf_kernel_cpu.h"

#include <algorithm>
#include <cmath>

#if defined(__x86_64__)
#include <xmmintrin.h>
#endif

// Each kernel is compiled for several instruction sets in this one file, with attributes instead of compiler
// flags: functions of the standard library that are instantiated here stay free of what other processors
// lack.
#define S2GS_INLINE __attribute__((always_inline)) inline

namespace s2gs {
namespace {

// Planes by index, from an array of structures to a structure of arrays. \return  whether any has a weight.
S2GS_INLINE bool GatherPlanes(const PixelPlane* planes, const int32_t* index, float* a, float* b, float* c,
                              float* w) {
#if defined(__x86_64__)
  __m128 any = _mm_setzero_ps();
  for (int i = 0; i < kPointGroup; i += 4) {
    __m128 row0 = _mm_load_ps(&planes[index[i]].a);
    __m128 row1 = _mm_load_ps(&planes[index[i + 1]].a);
    __m128 row2 = _mm_load_ps(&planes[index[i + 2]].a);
    __m128 row3 = _mm_load_ps(&planes[index[i + 3]].a);
    _MM_TRANSPOSE4_PS(row0, row1, row2, row3);
    _mm_store_ps(a + i, row0);
    _mm_store_ps(b + i, row1);
    _mm_store_ps(c + i, row2);
    _mm_store_ps(w + i, row3);
    any = _mm_or_ps(any, row3);
  }
  return _mm_movemask_ps(_mm_cmpneq_ps(any, _mm_setzero_ps())) != 0;
#else
  bool any = false;
  for (int i = 0; i < kPointGroup; ++i) {
    const PixelPlane& plane = planes[index[i]];
    a[i] = plane.a;
    b[i] = plane.b;
    c[i] = plane.c;
    w[i] = plane.weight;
    any |= plane.weight != 0;
  }
  return any;
#endif
}

struct alignas(64) Lanes {
  float values[kPointGroup];
};

S2GS_INLINE bool SamplePoints(const TsdfViewParams& view, const TsdfVoxelParams& params,
                              const float* __restrict x, const float* __restrict y, const float* __restrict z,
                              int32_t* __restrict index, float* __restrict distance,
                              float* __restrict weight) {
  int any_index = 0;
#pragma omp simd reduction(| : any_index)
  for (int i = 0; i < kPointGroup; ++i) {
    index[i] = PlaneIndex(view, x[i], y[i], z[i]);
    any_index |= index[i];
  }
  if (any_index == kOutsideImage) return false;
  // By value: what is behind a reference could change in the loop.
  const TsdfVoxelParams voxel = params;
  const float focal = view.focal;
  Lanes a;
  Lanes b;
  Lanes c;
  Lanes w;
  if (!GatherPlanes(view.planes, index, a.values, b.values, c.values, w.values)) return false;
#pragma omp simd
  for (int i = 0; i < kPointGroup; ++i) {
    float point_distance = 0;
    float point_weight = 0;
    SamplePlane(voxel, focal, a.values[i], b.values[i], c.values[i], w.values[i], x[i], y[i], z[i],
                &point_distance, &point_weight);
    distance[i] = point_distance;
    weight[i] = point_weight;
  }
  return true;
}

S2GS_INLINE void AddToBlock(const TsdfViewParams& view, const TsdfVoxelParams& params,
                            const float* first_voxel, float* sums, float* weights) {
  static_assert(kPointGroup == kBlockSide * kBlockSide);
  float rotation[9];
  for (int i = 0; i < 9; ++i) rotation[i] = static_cast<float>(view.rotation[i]);
  for (int slice = 0; slice < kBlockSide; ++slice) {
    const auto dz = static_cast<float>(slice);
    Lanes x;
    Lanes y;
    Lanes z;
#pragma omp simd
    for (int i = 0; i < kPointGroup; ++i) {
      const auto dx = static_cast<float>(i & 7);
      const auto dy = static_cast<float>(i >> 3);
      x.values[i] = first_voxel[0] + rotation[0] * dx + rotation[1] * dy + rotation[2] * dz;
      y.values[i] = first_voxel[1] + rotation[3] * dx + rotation[4] * dy + rotation[5] * dz;
      z.values[i] = first_voxel[2] + rotation[6] * dx + rotation[7] * dy + rotation[8] * dz;
    }
    alignas(64) int32_t index[kPointGroup];
    Lanes distance;
    Lanes weight;
    if (!SamplePoints(view, params, x.values, y.values, z.values, index, distance.values, weight.values)) {
      continue;
    }
    float* __restrict slice_sums = sums + slice * kPointGroup;
    float* __restrict slice_weights = weights + slice * kPointGroup;
#pragma omp simd
    for (int i = 0; i < kPointGroup; ++i) {
      slice_sums[i] += weight.values[i] * distance.values[i];
      slice_weights[i] += weight.values[i];
    }
  }
}

// Slope of five values in a row at the middle one, which must not stand alone. Across an edge or a jump
// the side is taken whose continuation meets the middle. Branch-free.
S2GS_INLINE float Slope(float left2, float left, float middle, float right, float right2, float pixel) {
  constexpr float kFar = 1e30F;
  const bool has_left = left > 0.0F;
  const bool has_right = right > 0.0F;
  const bool is_smooth = has_left & has_right & (std::fabs(left + right - 2.0F * middle) < 0.5F * pixel);
  const float left_gap = std::fabs(2.0F * left - left2 - middle);
  const float right_gap = std::fabs(2.0F * right - right2 - middle);
  const float left_error = left2 > 0.0F ? left_gap : kFar;
  const float right_error = right2 > 0.0F ? right_gap : kFar;
  const float left_slope = middle - left;
  const float right_slope = right - middle;
  const bool is_left_better = (left_error < right_error) | ((left_error == right_error) &
                                                            (std::fabs(left_slope) < std::fabs(right_slope)));
  const bool take_left = has_left & (!has_right | is_left_better);
  const float central = 0.5F * (right - left);
  const float one_sided = take_left ? left_slope : right_slope;
  return is_smooth ? central : one_sided;
}

S2GS_INLINE void PlanesOfRow(const TsdfRowJob& job) {
  const float* above2 = job.inverse_depths[0];
  const float* above = job.inverse_depths[1];
  const float* row = job.inverse_depths[2];
  const float* below = job.inverse_depths[3];
  const float* below2 = job.inverse_depths[4];
  const float step = 1.0F / job.fx;
  const float fx = job.fx;
  const float fy = job.fy;
  const float first_ray_x = job.first_ray_x;
  const float ray_y = job.ray_y;
  const float min_cosine = job.min_cosine;
  for (int begin = 0; begin < job.count; begin += kPointGroup) {
    const int count = std::min(kPointGroup, job.count - begin);
    Lanes a;
    Lanes b;
    Lanes c;
    Lanes w;
#pragma omp simd
    for (int i = 0; i < count; ++i) {
      const int x = begin + i;
      const float middle = row[x];
      const float slope_x = Slope(row[x - 2], row[x - 1], middle, row[x + 1], row[x + 2], middle / fx);
      const float slope_y = Slope(above2[x], above[x], middle, below[x], below2[x], middle / fy);
      const float ray_x = first_ray_x + step * static_cast<float>(x);
      a.values[i] = slope_x * fx;
      b.values[i] = slope_y * fy;
      c.values[i] = middle - a.values[i] * ray_x - b.values[i] * ray_y;
      const float norm2 = a.values[i] * a.values[i] + b.values[i] * b.values[i] + c.values[i] * c.values[i];
      const float cosine = middle / std::sqrt(norm2 * (1.0F + ray_x * ray_x + ray_y * ray_y) + 1e-37F);
      const bool is_known_x = (row[x - 1] > 0.0F) | (row[x + 1] > 0.0F);
      const bool is_known_y = (above[x] > 0.0F) | (below[x] > 0.0F);
      const bool counts = is_known_x & is_known_y & (cosine >= min_cosine);
      const float weight = cosine * middle * middle;
      w.values[i] = counts ? weight : 0.0F;
    }
    for (int i = 0; i < count; ++i) {
      if (!(row[begin + i] > 0)) continue;
      job.planes[begin + i] = {a.values[i], b.values[i], c.values[i], w.values[i]};
    }
  }
}

void SamplePointsOrNothing(bool is_seen, float* weight) {
  if (!is_seen) std::fill(weight, weight + kPointGroup, 0.0F);
}

// NOLINTBEGIN(bugprone-macro-parentheses): an attribute cannot stand in parentheses.
#define S2GS_TSDF_KERNEL(NAME, ATTRIBUTES)                                                           \
  ATTRIBUTES void AddToBlock##NAME(const TsdfViewParams& view, const TsdfVoxelParams& params,        \
                                   const float* first_voxel, float* sums, float* weights) {          \
    AddToBlock(view, params, first_voxel, sums, weights);                                            \
  }                                                                                                  \
  ATTRIBUTES void SamplePoints##NAME(const TsdfViewParams& view, const TsdfVoxelParams& params,      \
                                     const float* x, const float* y, const float* z, int32_t* index, \
                                     float* distance, float* weight) {                               \
    SamplePointsOrNothing(SamplePoints(view, params, x, y, z, index, distance, weight), weight);     \
  }                                                                                                  \
  ATTRIBUTES void PlanesOfRow##NAME(const TsdfRowJob& job) { PlanesOfRow(job); }                     \
  constexpr TsdfCpuKernel kKernel##NAME = {AddToBlock##NAME, SamplePoints##NAME, PlanesOfRow##NAME};
// NOLINTEND(bugprone-macro-parentheses)

S2GS_TSDF_KERNEL(Portable, )
#if defined(__x86_64__)
S2GS_TSDF_KERNEL(Avx2, __attribute__((target("avx2"))))
S2GS_TSDF_KERNEL(Avx512, __attribute__((target("avx512f,avx512vl,avx512dq,avx512bw"))))
#endif

#undef S2GS_TSDF_KERNEL

}  // namespace

const TsdfCpuKernel& BestTsdfCpuKernel() {
#if defined(__x86_64__)
  if (__builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512vl") &&
      __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512bw")) {
    return kKernelAvx512;
  }
  if (__builtin_cpu_supports("avx2")) return kKernelAvx2;
#endif
  return kKernelPortable;
}

}  // namespace s2gs
