#include "s2gs/core/cuda.h"
#include "s2gs/cuda/optimise.h"
#include "s2gs/kernel/sh.h"

namespace s2gs::cuda {
namespace {

constexpr int kThreads = 128;

// Updates kCount planes from `plane` on. All is loaded before anything is stored: as many loads are under
// way.
template <int kCount>
__device__ void UpdatePlanes(const OptimiseInput& in, int plane, int i, const float (&gradient)[kCount],
                             const float (&rate)[kCount]) {
  const size_t stride = in.parameters.stride;
  float* const parameter = in.parameters.At(plane) + i;
  float* const first = in.first_moments.At(plane) + i;
  float* const second = in.second_moments.At(plane) + i;
  float x[kCount], m[kCount], v[kCount];
#pragma unroll
  for (int k = 0; k < kCount; ++k) {
    x[k] = parameter[k * stride];
    m[k] = first[k * stride];
    v[k] = second[k * stride];
  }
#pragma unroll
  for (int k = 0; k < kCount; ++k) UpdateByAdam(in.adam, rate[k], gradient[k], &x[k], &m[k], &v[k]);
#pragma unroll
  for (int k = 0; k < kCount; ++k) {
    parameter[k * stride] = x[k];
    first[k * stride] = m[k];
    second[k * stride] = v[k];
  }
}

// Takes the loss by one splat out of the buffer and leaves zeros.
__device__ Splat<float> TakeSplatGradient(const OptimiseInput& in, int i) {
  auto* packed = reinterpret_cast<float4*>(in.d_splats + static_cast<size_t>(i) * kPackedFloats);
  float normal_z = 0;
  if (in.has_geometry) {
    normal_z = in.d_normal_z[i];
    in.d_normal_z[i] = 0;
  }
  const Splat<float> d = Unpack(packed[0], packed[1], packed[2], packed[3], normal_z);
  const float4 zero = {0, 0, 0, 0};
  for (int k = 0; k < 4; ++k) packed[k] = zero;
  return d;
}

template <int kDegree>
__global__ __launch_bounds__(kThreads) void OptimiseKernel(OptimiseInput in) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i >= in.count) return;
  const bool is_drawn = in.splats.tile_counts[i] > 0;
  Splat<float> d{};
  if (is_drawn) d = TakeSplatGradient(in, i);
  if (in.report->overflow != 0) return;
  if (i == 0) in.sums->steps += 1;

  SurfelParameters<float> gradient{};
  Vec3<float> d_dc = {0, 0, 0};
  Vec3<float> d_color = {0, 0, 0};
  float basis[kShRestPerChannel] = {};
  if (is_drawn) {
    const SurfelParameters<float> g = LoadSurfel(in.parameters, i);
    const SplatCamera<float>& camera = in.view.camera;
    Surfel<float> surfel;
    Footprint<float> footprint;
    TransformSurfel(g, camera, in.view.rule, &surfel);
    ComputeFootprint(surfel, camera, &footprint);
    Surfel<float> d_surfel{};
    d_surfel.opacity = d.opacity;
    d_surfel.foreground = d.foreground;
    const float4 packed_color = in.splats.splats[i].c;
    const Vec3<float> color = {packed_color.y, packed_color.z, packed_color.w};
    d_color = {color.x > 0 ? d.color.x : 0, color.y > 0 ? d.color.y : 0, color.z > 0 ? d.color.z : 0};
    d_surfel.view_direction = ShColorAdjoint(
        kDegree, [&](int k, int channel) { return in.parameters.At(kShRest + 3 * k + channel)[i]; },
        surfel.view_direction, color, d.color, &d_dc, [](int /*k*/, const Vec3<float>& /*d_rest*/) {});
    ShRestBasis(kDegree, surfel.view_direction, basis);
    ComputeFootprintAdjoint(surfel, camera, footprint, d.footprint, &d_surfel);
    if (in.gradient_sum != nullptr) {
      // By the centre's movement across the image, in 2DGS's units: half the image's size.
      const float x =
          d_surfel.centre.x * surfel.centre.z / camera.fx * 0.5F * static_cast<float>(camera.width);
      const float y =
          d_surfel.centre.y * surfel.centre.z / camera.fy * 0.5F * static_cast<float>(camera.height);
      const float length = sqrtf(x * x + y * y);
      if (isfinite(length)) {
        in.gradient_sum[i] += length;
        in.view_count[i] += 1;
      }
    }
    gradient = TransformSurfelAdjoint(g, camera, in.view.rule, surfel, d_surfel);
  }

  const LearningRates& r = in.rates;
  static_assert(kLogScale == 3 && kRotation == 5 && kOpacity == 9 && kForeground == 10, "the order below");
  const float geometry[10] = {gradient.centre.x,     gradient.centre.y,    gradient.centre.z,
                              gradient.log_scale.x,  gradient.log_scale.y, gradient.rotation.w,
                              gradient.rotation.x,   gradient.rotation.y,  gradient.rotation.z,
                              gradient.opacity_logit};
  const float geometry_rates[10] = {r.centre,   r.centre,   r.centre,   r.log_scale, r.log_scale,
                                    r.rotation, r.rotation, r.rotation, r.rotation,  r.opacity};
  UpdatePlanes(in, kCentre, i, geometry, geometry_rates);
  if (in.learns_foreground) {
    if (in.d_logits != nullptr) gradient.foreground_logit += in.d_logits[i];
    const float foreground[1] = {gradient.foreground_logit};
    const float foreground_rate[1] = {r.foreground};
    UpdatePlanes(in, kForeground, i, foreground, foreground_rate);
  }
  const float dc[3] = {d_dc.x, d_dc.y, d_dc.z};
  const float dc_rates[3] = {r.sh_dc, r.sh_dc, r.sh_dc};
  UpdatePlanes(in, kShDc, i, dc, dc_rates);
  if constexpr (kDegree > 0) {
    // In equal parts that the registers hold: 3; 4 + 4; 5 + 5 + 5 coefficients.
    constexpr int kCount = (kDegree + 1) * (kDegree + 1) - 1;
    constexpr int kPart = 2 + kDegree;
    static_assert(kCount % kPart == 0);
    float rates[3 * kPart];
#pragma unroll
    for (float& rate : rates) rate = r.sh_rest;
#pragma unroll
    for (int first = 0; first < kCount; first += kPart) {
      float rest[3 * kPart];
#pragma unroll
      for (int k = 0; k < kPart; ++k) {
        rest[3 * k] = basis[first + k] * d_color.x;
        rest[3 * k + 1] = basis[first + k] * d_color.y;
        rest[3 * k + 2] = basis[first + k] * d_color.z;
      }
      UpdatePlanes(in, kShRest + 3 * first, i, rest, rates);
    }
  }
}

}  // namespace

void Optimise(const OptimiseInput& input, cudaStream_t stream) {
  const unsigned blocks = NumBlocks(input.count, kThreads);
  switch (input.view.sh_degree) {
    case 0:
      OptimiseKernel<0><<<blocks, kThreads, 0, stream>>>(input);
      break;
    case 1:
      OptimiseKernel<1><<<blocks, kThreads, 0, stream>>>(input);
      break;
    case 2:
      OptimiseKernel<2><<<blocks, kThreads, 0, stream>>>(input);
      break;
    default:
      OptimiseKernel<3><<<blocks, kThreads, 0, stream>>>(input);
      break;
  }
  CheckCuda(cudaGetLastError(), "optimiser");
}

}  // namespace s2gs::cuda
