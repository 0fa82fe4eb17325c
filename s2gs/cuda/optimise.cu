#include "s2gs/core/cuda.h"
#include "s2gs/cuda/optimise.h"
#include "s2gs/cuda/packed_rows.cuh"
#include "s2gs/cuda/sh_ahead.cuh"
#include "s2gs/kernel/sh.h"

namespace s2gs::cuda {
namespace {

constexpr int kThreads = 128;

// The gradient's planes: those of the geometry and p as in the model, then what all SH coefficients share.
constexpr int kGradientColor = kForeground + 1;
constexpr int kGradientDirection = kGradientColor + 3;
static_assert(kGradientDirection + 3 == kGradientPlanes);

// Adds to the sums for densification.
__device__ void CountGradient(const OptimiseInput& in, int i, const Surfel<float>& surfel,
                              const Vec3<float>& d_centre) {
  const SplatCamera<float>& camera = in.view.camera;
  // By the centre's movement across the image, in 2DGS's units: half the image's size.
  const float x = d_centre.x * surfel.centre.z / camera.fx * 0.5F * static_cast<float>(camera.width);
  const float y = d_centre.y * surfel.centre.z / camera.fy * 0.5F * static_cast<float>(camera.height);
  const float length = sqrtf(x * x + y * y);
  if (!isfinite(length)) return;
  in.gradient_sum[i] += length;
  in.view_count[i] += 1;
}

template <int kDegree>
__global__ __launch_bounds__(kThreads) void GradientKernel(OptimiseInput in) {
  __shared__ ShAhead<kDegree, kThreads> sh;
  __shared__ PackedRows<kThreads> rows;
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  const bool is_drawn = i < in.count && in.splats.tile_counts[i] > 0;
  const unsigned drawn = __ballot_sync(0xFFFFFFFFU, is_drawn);
  const bool is_overflow = in.report->overflow != 0;
  // All that is read of a Gaussian is on its way before anything is waited for.
  const auto warp_begin = static_cast<size_t>(i) - threadIdx.x % 32;
  auto* const warp_rows = reinterpret_cast<float4*>(in.d_splats + warp_begin * kPackedFloats);
  rows.Load(warp_rows, drawn);
  SurfelParameters<float> g{};
  Vec3<float> color = {0, 0, 0};
  float d_normal_z = 0;
  if (is_drawn && !is_overflow) {
    sh.Load(in.parameters, i);
    g = LoadSurfel(in.parameters, i);
    const float4 packed_color = in.splats.splats[i].c;
    color = {packed_color.y, packed_color.z, packed_color.w};
    if (in.has_geometry) d_normal_z = in.d_normal_z[i];
  }
  rows.Wait();
  // Zeros are left for the next step.
  rows.StoreZeros(warp_rows, drawn);
  if (is_drawn && in.has_geometry) in.d_normal_z[i] = 0;
  if (i >= in.count || is_overflow) return;
  if (i == 0) in.sums->steps += 1;

  SurfelParameters<float> gradient{};
  Vec3<float> d_color = {0, 0, 0};
  Vec3<float> direction = {0, 0, 1};
  if (is_drawn) {
    const PackedSplat packed = rows.Get();
    const Splat<float> d = Unpack(packed.a, packed.b, packed.c, packed.d, d_normal_z);
    Surfel<float> surfel;
    Footprint<float> footprint;
    TransformSurfel(g, in.view.camera, in.view.rule, &surfel);
    ComputeFootprint(surfel, in.view.camera, &footprint);
    Surfel<float> d_surfel{};
    d_surfel.opacity = d.opacity;
    d_surfel.foreground = d.foreground;
    d_color = {color.x > 0 ? d.color.x : 0, color.y > 0 ? d.color.y : 0, color.z > 0 ? d.color.z : 0};
    Vec3<float> unused;
    d_surfel.view_direction = ShColorAdjoint(
        kDegree, [&](int k, int channel) { return sh.At(k, channel); }, surfel.view_direction, color, d.color,
        &unused, [](int /*k*/, const Vec3<float>& /*d_rest*/) {});
    direction = surfel.view_direction;
    ComputeFootprintAdjoint(surfel, in.view.camera, footprint, d.footprint, &d_surfel);
    if (in.gradient_sum != nullptr) CountGradient(in, i, surfel, d_surfel.centre);
    gradient = TransformSurfelAdjoint(g, in.view.camera, in.view.rule, surfel, d_surfel);
  }
  if (!is_drawn && in.only_drawn) return;
  if (in.learns_foreground && in.d_logits != nullptr) gradient.foreground_logit += in.d_logits[i];

  static_assert(kCentre == 0 && kLogScale == 3 && kRotation == 5 && kOpacity == 9 && kForeground == 10,
                "the order below");
  const float planes[kGradientPlanes] = {gradient.centre.x,
                                         gradient.centre.y,
                                         gradient.centre.z,
                                         gradient.log_scale.x,
                                         gradient.log_scale.y,
                                         gradient.rotation.w,
                                         gradient.rotation.x,
                                         gradient.rotation.y,
                                         gradient.rotation.z,
                                         gradient.opacity_logit,
                                         gradient.foreground_logit,
                                         d_color.x,
                                         d_color.y,
                                         d_color.z,
                                         direction.x,
                                         direction.y,
                                         direction.z};
#pragma unroll
  for (int k = 0; k < kGradientPlanes; ++k) in.gradients.At(k)[i] = planes[k];
}

// --- Adam: four neighbouring Gaussians and up to three planes a thread -------------------------------------
struct Four {
  float v[4];
};

__device__ Four LoadFour(const float* plane, int i) {
  const float4 values = *reinterpret_cast<const float4*>(plane + i);
  return {{values.x, values.y, values.z, values.w}};
}
__device__ void StoreFour(float* plane, int i, const Four& values) {
  *reinterpret_cast<float4*>(plane + i) = {values.v[0], values.v[1], values.v[2], values.v[3]};
}

// Which of the Gaussians from i on are moved: a bit each.
__device__ unsigned MovedOf(const OptimiseInput& in, int i) {
  if (!in.only_drawn) return 15;
  const uint4 counts = *reinterpret_cast<const uint4*>(in.splats.tile_counts + i);
  return (counts.x > 0 ? 1U : 0U) | (counts.y > 0 ? 2U : 0U) | (counts.z > 0 ? 4U : 0U) |
         (counts.w > 0 ? 8U : 0U);
}

// Planes from `plane` on, of Gaussians from i on. All is loaded before anything is stored.
template <int kCount>
__device__ void UpdatePlanes(const OptimiseInput& in, int plane, int i, unsigned moved,
                             const Four (&gradient)[kCount], const float (&rate)[kCount]) {
  Four x[kCount], m[kCount], v[kCount];
#pragma unroll
  for (int k = 0; k < kCount; ++k) {
    x[k] = LoadFour(in.parameters.At(plane + k), i);
    m[k] = LoadFour(in.first_moments.At(plane + k), i);
    v[k] = LoadFour(in.second_moments.At(plane + k), i);
  }
#pragma unroll
  for (int k = 0; k < kCount; ++k) {
#pragma unroll
    for (int j = 0; j < 4; ++j) {
      if ((moved >> j & 1U) != 0)
        UpdateByAdam(in.adam, rate[k], gradient[k].v[j], &x[k].v[j], &m[k].v[j], &v[k].v[j]);
    }
    StoreFour(in.parameters.At(plane + k), i, x[k]);
    StoreFour(in.first_moments.At(plane + k), i, m[k]);
    StoreFour(in.second_moments.At(plane + k), i, v[k]);
  }
}

// Element k of ShRestBasis. The others cost nothing: k is the same for all threads of a block.
template <int kFirst = 0>
__device__ float OneShBasis(int k, const Vec3<float>& direction) {
  if constexpr (kFirst < kShRestPerChannel) {
    if (k != kFirst) return OneShBasis<kFirst + 1>(k, direction);
    float basis[kShRestPerChannel];
    ShRestBasis(kMaxShDegree, direction, basis);
    return basis[kFirst];
  }
  return 0;
}

__device__ float RateOf(const LearningRates& r, int plane) {
  return plane < kLogScale     ? r.centre
         : plane < kRotation   ? r.log_scale
         : plane < kOpacity    ? r.rotation
         : plane < kForeground ? r.opacity
                               : r.foreground;
}

// Rows of blocks: three planes of the geometry each, then one SH coefficient each, from band 0 on.
constexpr int kGeometryRows = 3;
__global__ __launch_bounds__(kThreads) void AdamKernel(OptimiseInput in) {
  const int i = 4 * static_cast<int>(blockIdx.y * blockDim.x + threadIdx.x);
  // Planes are padded, so that the last four may reach beyond the last Gaussian.
  if (i >= in.count || in.report->overflow != 0) return;
  const unsigned moved = MovedOf(in, i);
  if (moved == 0) return;
  const auto row = static_cast<int>(blockIdx.x);
  if (row < kGeometryRows) {
    const int plane = 3 * row;
    Four gradient[3];
    float rate[3];
#pragma unroll
    for (int k = 0; k < 3; ++k) {
      gradient[k] = LoadFour(in.gradients.At(plane + k), i);
      rate[k] = RateOf(in.rates, plane + k);
    }
    UpdatePlanes(in, plane, i, moved, gradient, rate);
    return;
  }
  if (row == kGeometryRows) {
    const Four opacity[1] = {LoadFour(in.gradients.At(kOpacity), i)};
    UpdatePlanes(in, kOpacity, i, moved, opacity, {in.rates.opacity});
    if (!in.learns_foreground) return;
    const Four foreground[1] = {LoadFour(in.gradients.At(kForeground), i)};
    UpdatePlanes(in, kForeground, i, moved, foreground, {in.rates.foreground});
    return;
  }
  const int k = row - kGeometryRows - 2;  // -1: band 0.
  const float rate = k < 0 ? in.rates.sh_dc : in.rates.sh_rest;
  Four basis = {{kShBand0, kShBand0, kShBand0, kShBand0}};
  if (k >= 0) {
    const Four x = LoadFour(in.gradients.At(kGradientDirection), i);
    const Four y = LoadFour(in.gradients.At(kGradientDirection + 1), i);
    const Four z = LoadFour(in.gradients.At(kGradientDirection + 2), i);
#pragma unroll
    for (int j = 0; j < 4; ++j) basis.v[j] = OneShBasis(k, {x.v[j], y.v[j], z.v[j]});
  }
  Four gradient[3];
#pragma unroll
  for (int channel = 0; channel < 3; ++channel) {
    gradient[channel] = LoadFour(in.gradients.At(kGradientColor + channel), i);
#pragma unroll
    for (int j = 0; j < 4; ++j) gradient[channel].v[j] *= basis.v[j];
  }
  static_assert(kShRest == kShDc + 3, "band 0 is the coefficient before the first of the others");
  UpdatePlanes(in, kShRest + 3 * k, i, moved, gradient, {rate, rate, rate});
}

template <int kDegree>
void Launch(const OptimiseInput& input, cudaStream_t stream) {
  GradientKernel<kDegree><<<NumBlocks(input.count, kThreads), kThreads, 0, stream>>>(input);
  // All rows of some Gaussians before the next Gaussians: what they share is then still in the cache.
  const dim3 grid(kGeometryRows + 2 + ShRestCount(kDegree), NumBlocks(input.count, 4 * kThreads));
  AdamKernel<<<grid, kThreads, 0, stream>>>(input);
}

}  // namespace

void Optimise(const OptimiseInput& input, cudaStream_t stream) {
  S2GS_INVARIANT(input.parameters.stride % kPlaneAlignment == 0 &&
                 input.gradients.stride % kPlaneAlignment == 0);
  switch (input.view.sh_degree) {
    case 0:
      Launch<0>(input, stream);
      break;
    case 1:
      Launch<1>(input, stream);
      break;
    case 2:
      Launch<2>(input, stream);
      break;
    default:
      Launch<3>(input, stream);
      break;
  }
  CheckCuda(cudaGetLastError(), "optimiser");
}

}  // namespace s2gs::cuda
