#include "s2gs/core/cuda.h"
#include "s2gs/cuda/optimise.h"
#include "s2gs/cuda/packed_rows.cuh"
#include "s2gs/kernel/sh.h"

namespace s2gs::cuda {
namespace {

constexpr int kThreads = 128;
// Planes that are on their way at once, before any of them is stored.
constexpr int kAtOnce = 7;
static_assert(kShRest % kAtOnce == 0);

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

__device__ float RateOf(const LearningRates& r, int plane) {
  return plane < kLogScale     ? r.centre
         : plane < kRotation   ? r.log_scale
         : plane < kOpacity    ? r.rotation
         : plane < kForeground ? r.opacity
         : plane < kShDc       ? r.foreground
                               : r.sh_dc;
}

// \param kHasBands  the colour has more than band 0.
template <bool kHasBands>
__global__ __launch_bounds__(kThreads, 5) void LearnKernel(OptimiseInput in) {
  __shared__ PackedRows<kThreads> rows;
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  bool is_drawn = i < in.count && in.splats.tile_counts[i] > 0;
  const unsigned drawn = __ballot_sync(0xFFFFFFFFU, is_drawn);
  const bool is_overflow = in.report->overflow != 0;
  if (i == 0) in.is_skipped[in.color_slot] = is_overflow ? 1 : 0;
  // All that is read of a Gaussian is on its way before anything is waited for.
  const auto warp_begin = static_cast<size_t>(i) - threadIdx.x % 32;
  auto* const warp_rows = reinterpret_cast<float4*>(in.d_splats + warp_begin * kPackedFloats);
  rows.Load(warp_rows, drawn);
  SurfelParameters<float> g{};
  unsigned traits = 0;
  Vec3<float> by_direction[3] = {};
  float d_normal_z = 0;
  if (is_drawn && !is_overflow) {
    g = LoadSurfel(in.parameters, i);
    traits = in.color_traits[i];
    if constexpr (kHasBands) {
      const auto at = [&](int k) { return in.scratch.At(kColorByDirection + k)[i]; };
#pragma unroll
      for (int c = 0; c < 3; ++c) by_direction[c] = {at(3 * c), at(3 * c + 1), at(3 * c + 2)};
    }
    if (in.has_geometry) d_normal_z = in.d_normal_z[i];
  }
  rows.Wait();
  // Zeros are left for the next step.
  rows.StoreZeros(warp_rows, drawn);
  if (is_drawn && in.has_geometry) in.d_normal_z[i] = 0;
  if (i >= in.count || is_overflow) return;
  if (i == 0) in.sums->steps += 1;
  is_drawn = is_drawn && (traits & kIsDrawable) != 0;

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
    d_color = {(traits & kRedIsLit) != 0 ? d.color.x : 0, (traits & kGreenIsLit) != 0 ? d.color.y : 0,
               (traits & kBlueIsLit) != 0 ? d.color.z : 0};
    d_surfel.view_direction =
        d_color.x * by_direction[0] + d_color.y * by_direction[1] + d_color.z * by_direction[2];
    direction = surfel.view_direction;
    ComputeFootprintAdjoint(surfel, in.view.camera, footprint, d.footprint, &d_surfel);
    if (in.gradient_sum != nullptr) CountGradient(in, i, surfel, d_surfel.centre);
    gradient = TransformSurfelAdjoint(g, in.view.camera, in.view.rule, surfel, d_surfel);
  }
  if constexpr (kHasBands) {
    const float handed_on[kPlanesOfSlot] = {d_color.x,   d_color.y,   d_color.z,
                                            direction.x, direction.y, direction.z};
    const Planes slot = ColorSlot(in.scratch, in.color_slot);
#pragma unroll
    for (int k = 0; k < kPlanesOfSlot; ++k) slot.At(k)[i] = handed_on[k];
  }
  if (!is_drawn && in.only_drawn) return;
  if (in.learns_foreground && in.d_logits != nullptr) gradient.foreground_logit += in.d_logits[i];

  static_assert(kCentre == 0 && kLogScale == 3 && kRotation == 5 && kOpacity == 9 && kForeground == 10 &&
                    kShDc == 11 && kShRest == 14,
                "the order below");
  constexpr auto kBand0 = static_cast<float>(kShBand0);
  const float by_plane[kShRest] = {gradient.centre.x,      gradient.centre.y,         gradient.centre.z,
                                   gradient.log_scale.x,   gradient.log_scale.y,      gradient.rotation.w,
                                   gradient.rotation.x,    gradient.rotation.y,       gradient.rotation.z,
                                   gradient.opacity_logit, gradient.foreground_logit, kBand0 * d_color.x,
                                   kBand0 * d_color.y,     kBand0 * d_color.z};
#pragma unroll
  for (int begin = 0; begin < kShRest; begin += kAtOnce) {
    float x[kAtOnce], m[kAtOnce], v[kAtOnce];
#pragma unroll
    for (int k = 0; k < kAtOnce; ++k) {
      x[k] = in.parameters.At(begin + k)[i];
      m[k] = in.first_moments.At(begin + k)[i];
      v[k] = in.second_moments.At(begin + k)[i];
    }
#pragma unroll
    for (int k = 0; k < kAtOnce; ++k) {
      const int plane = begin + k;
      if (plane == kForeground && !in.learns_foreground) continue;
      UpdateByAdam(in.adam, RateOf(in.rates, plane), by_plane[plane], &x[k], &m[k], &v[k]);
      in.parameters.At(plane)[i] = x[k];
      in.first_moments.At(plane)[i] = m[k];
      in.second_moments.At(plane)[i] = v[k];
    }
  }
}

}  // namespace

void Optimise(const OptimiseInput& input, cudaStream_t stream) {
  const unsigned blocks = NumBlocks(input.count, kThreads);
  if (input.view.sh_degree > 0) {
    LearnKernel<true><<<blocks, kThreads, 0, stream>>>(input);
  } else {
    LearnKernel<false><<<blocks, kThreads, 0, stream>>>(input);
  }
  CheckCuda(cudaGetLastError(), "optimiser");
}

}  // namespace s2gs::cuda
