#include "s2gs/core/cuda.h"
#include "s2gs/cuda/optimise.h"
#include "s2gs/kernel/sh.h"

namespace s2gs::cuda {
namespace {

constexpr int kThreads = 128;

__device__ void UpdatePlane(const OptimiseInput& in, int plane, int i, float gradient, float rate) {
  UpdateByAdam(in.adam, rate, gradient, in.parameters.At(plane) + i, in.first_moments.At(plane) + i,
               in.second_moments.At(plane) + i);
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

  UpdatePlane(in, kCentre, i, gradient.centre.x, in.rates.centre);
  UpdatePlane(in, kCentre + 1, i, gradient.centre.y, in.rates.centre);
  UpdatePlane(in, kCentre + 2, i, gradient.centre.z, in.rates.centre);
  UpdatePlane(in, kLogScale, i, gradient.log_scale.x, in.rates.log_scale);
  UpdatePlane(in, kLogScale + 1, i, gradient.log_scale.y, in.rates.log_scale);
  UpdatePlane(in, kRotation, i, gradient.rotation.w, in.rates.rotation);
  UpdatePlane(in, kRotation + 1, i, gradient.rotation.x, in.rates.rotation);
  UpdatePlane(in, kRotation + 2, i, gradient.rotation.y, in.rates.rotation);
  UpdatePlane(in, kRotation + 3, i, gradient.rotation.z, in.rates.rotation);
  UpdatePlane(in, kOpacity, i, gradient.opacity_logit, in.rates.opacity);
  if (in.learns_foreground) {
    if (in.d_logits != nullptr) gradient.foreground_logit += in.d_logits[i];
    UpdatePlane(in, kForeground, i, gradient.foreground_logit, in.rates.foreground);
  }
  UpdatePlane(in, kShDc, i, d_dc.x, in.rates.sh_dc);
  UpdatePlane(in, kShDc + 1, i, d_dc.y, in.rates.sh_dc);
  UpdatePlane(in, kShDc + 2, i, d_dc.z, in.rates.sh_dc);
  constexpr int kCount = (kDegree + 1) * (kDegree + 1) - 1;
#pragma unroll
  for (int k = 0; k < kCount; ++k) {
    UpdatePlane(in, kShRest + 3 * k, i, basis[k] * d_color.x, in.rates.sh_rest);
    UpdatePlane(in, kShRest + 3 * k + 1, i, basis[k] * d_color.y, in.rates.sh_rest);
    UpdatePlane(in, kShRest + 3 * k + 2, i, basis[k] * d_color.z, in.rates.sh_rest);
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
