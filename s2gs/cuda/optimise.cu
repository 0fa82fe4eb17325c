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
  Vec3<float> direction = {0, 0, 1};
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
    direction = surfel.view_direction;
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
    const float shared[6] = {d_color.x, d_color.y, d_color.z, direction.x, direction.y, direction.z};
#pragma unroll
    for (int k = 0; k < 6; ++k) in.d_colors[static_cast<size_t>(k) * in.count + i] = shared[k];
  }
}

// Three quarters of all parameters are bands 1 to 3 of SH. A thread updates three coefficients in all
// channels: few registers, and enough threads to keep the memory busy. Coefficients from 3 blockIdx.y on.
template <int kDegree>
__global__ __launch_bounds__(kThreads) void OptimiseShRestKernel(OptimiseInput in) {
  constexpr int kCount = (kDegree + 1) * (kDegree + 1) - 1;
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  const int first = 3 * static_cast<int>(blockIdx.y);
  if (i >= in.count || in.report->overflow != 0) return;
  const auto shared = [&](int k) { return in.d_colors[static_cast<size_t>(k) * in.count + i]; };
  const float d_color[3] = {shared(0), shared(1), shared(2)};
  float basis[kShRestPerChannel];
  ShRestBasis(kDegree, Vec3<float>{shared(3), shared(4), shared(5)}, basis);
  float gradient[9], rates[9];
#pragma unroll
  for (int k = 0; k < 3; ++k) {
    float value = 0;
    // Constant indices keep the basis in registers.
#pragma unroll
    for (int j = 0; j < kCount; ++j) {
      if (j == first + k) value = basis[j];
    }
#pragma unroll
    for (int channel = 0; channel < 3; ++channel) {
      gradient[3 * k + channel] = value * d_color[channel];
      rates[3 * k + channel] = in.rates.sh_rest;
    }
  }
  UpdatePlanes(in, kShRest + 3 * first, i, gradient, rates);
}

template <int kDegree>
void Launch(const OptimiseInput& input, cudaStream_t stream) {
  const unsigned blocks = NumBlocks(input.count, kThreads);
  OptimiseKernel<kDegree><<<blocks, kThreads, 0, stream>>>(input);
  if constexpr (kDegree > 0) {
    // 3, 8 and 15 coefficients; the ninth of degree 2 has no gradient and no moments.
    constexpr unsigned kParts = ((kDegree + 1) * (kDegree + 1) + 1) / 3;
    OptimiseShRestKernel<kDegree><<<dim3(blocks, kParts), kThreads, 0, stream>>>(input);
  }
}

}  // namespace

void Optimise(const OptimiseInput& input, cudaStream_t stream) {
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
