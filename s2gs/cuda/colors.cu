#include <algorithm>
#include <type_traits>

#include "s2gs/core/cuda.h"
#include "s2gs/cuda/colors.h"
#include "s2gs/kernel/sh.h"

namespace s2gs::cuda {
namespace {

constexpr int kThreads = 128;
// Blocks of a multiprocessor, each of which goes through many Gaussians: enough to keep memory busy, and few
// enough to leave room for the kernels beside.
constexpr int kBlocks = 3;
constexpr int kBlocksOfRegisters = 5;  // there would be registers for so many.
// Coefficients whose moments are on their way at once, before any of them is stored.
constexpr int kAtOnce = 5;

template <int kDegree>
constexpr int kRestCount = ShRestCount(kDegree);

template <int kDegree, bool kLearns, bool kDraws>
__global__ __launch_bounds__(kThreads, kBlocksOfRegisters) void ColorKernel(ColorInput in, ColorUpdate update,
                                                                            ProjectOptions view,
                                                                            PackedSplat* splats) {
  constexpr int kCount = kRestCount<kDegree>;
  constexpr int kRoom = kCount > 0 ? kCount : 1;
  const bool learns_any = kLearns && *update.is_skipped == 0;
  const auto count = static_cast<int>(in.count);
  const auto num_threads = static_cast<int>(gridDim.x) * kThreads;
  const size_t next = 3 * in.parameters.stride;  // from a coefficient's plane to that of the next, R to R
#pragma unroll 1
  for (int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x); i < count; i += num_threads) {
    const auto load3 = [&](const Planes& planes, int plane) {
      return Vec3<float>{planes.At(plane)[i], planes.At(plane + 1)[i], planes.At(plane + 2)[i]};
    };
    const bool learns = learns_any && (update.tile_counts == nullptr || update.tile_counts[i] > 0);
    if (!kDraws && !learns) continue;
    float basis_then[kRoom], basis[kRoom];
    if (learns) ShRestBasis(kDegree, load3(in.scratch, kViewDirection), basis_then);
    Vec3<float> direction{};
    float4 packed{};  // opacity and colour
    if constexpr (kDraws) {
      packed.x = Sigmoid(in.parameters.At(kOpacity)[i]);
      const float logit = in.parameters.At(kForeground)[i];
      const bool is_foreground = IsForeground(logit, view.rule);
      const float p = ForegroundProbability(logit, view.rule);
      direction = ViewDirection(
          CentreInCamera(load3(in.parameters, kCentre), p, is_foreground, view.camera, view.rule),
          is_foreground, view.camera);
      ShRestBasis(kDegree, direction, basis);
    }
#pragma unroll 1
    for (int channel = 0; channel < 3; ++channel) {
      float values[kRoom];
      float* const x = in.parameters.At(kShRest + channel) + i;
#pragma unroll
      for (int k = 0; k < kCount; ++k) values[k] = x[k * next];
      if (learns) {
        const float by_color = in.scratch.At(kByColor + channel)[i];
        float* const m = in.first_moments.At(kShRest + channel) + i;
        float* const v = in.second_moments.At(kShRest + channel) + i;
#pragma unroll
        for (int begin = 0; begin < kCount; begin += kAtOnce) {
          float first[kAtOnce], second[kAtOnce];
#pragma unroll
          for (int j = 0; j < kAtOnce && begin + j < kCount; ++j) {
            first[j] = m[(begin + j) * next];
            second[j] = v[(begin + j) * next];
          }
#pragma unroll
          for (int j = 0; j < kAtOnce && begin + j < kCount; ++j) {
            const int k = begin + j;
            UpdateByAdam(update.adam, update.rate, by_color * basis_then[k], &values[k], &first[j],
                         &second[j]);
            x[k * next] = values[k];
            m[k * next] = first[j];
            v[k * next] = second[j];
          }
        }
      }
      if constexpr (kDraws) {
        float color = 0.5F + static_cast<float>(kShBand0) * in.parameters.At(kShDc + channel)[i];
#pragma unroll
        for (int k = 0; k < kCount; ++k) color += basis[k] * values[k];
        // Not a number stays what it is, for IsDrawableColor.
        color = color < 0 ? 0 : color;
        if (channel == 0) packed.y = color;
        if (channel == 1) packed.z = color;
        if (channel == 2) packed.w = color;
        if constexpr (kDegree > 0) {
          const Vec3<float> by_direction = ShRestBasisAdjoint(kDegree, direction, values);
          float* const out = in.scratch.At(kColorByDirection + 3 * channel) + i;
          out[0] = by_direction.x;
          out[in.scratch.stride] = by_direction.y;
          out[2 * in.scratch.stride] = by_direction.z;
        }
      }
    }
    if constexpr (kDraws) splats[i].c = packed;
  }
}

// Calls run() with the degree as a constant.
template <typename Run>
void WithDegree(int degree, const Run& run) {
  switch (degree) {
    case 0:
      return run(std::integral_constant<int, 0>());
    case 1:
      return run(std::integral_constant<int, 1>());
    case 2:
      return run(std::integral_constant<int, 2>());
    default:
      return run(std::integral_constant<int, 3>());
  }
}

unsigned Grid(int64_t count) {
  int device = 0, processors = 0;
  CheckCuda(cudaGetDevice(&device), "cudaGetDevice");
  CheckCuda(cudaDeviceGetAttribute(&processors, cudaDevAttrMultiProcessorCount, device), "multiprocessors");
  return std::min(NumBlocks(count, kThreads), static_cast<unsigned>(processors * kBlocks));
}

}  // namespace

void DrawColors(const ColorInput& input, const ColorUpdate* update, const ProjectOptions& view,
                PackedSplat* splats, cudaStream_t stream) {
  if (input.count == 0) return;
  S2GS_INVARIANT(update == nullptr || update->sh_degree == view.sh_degree);
  WithDegree(view.sh_degree, [&](auto degree) {
    constexpr int kDegree = decltype(degree)::value;
    if (update != nullptr) {
      ColorKernel<kDegree, true, true>
          <<<Grid(input.count), kThreads, 0, stream>>>(input, *update, view, splats);
    } else {
      ColorKernel<kDegree, false, true><<<Grid(input.count), kThreads, 0, stream>>>(input, {}, view, splats);
    }
  });
  CheckCuda(cudaGetLastError(), "colours");
}

void LearnColors(const ColorInput& input, const ColorUpdate& update, cudaStream_t stream) {
  if (input.count == 0 || update.sh_degree == 0) return;
  WithDegree(update.sh_degree, [&](auto degree) {
    ColorKernel<decltype(degree)::value, true, false>
        <<<Grid(input.count), kThreads, 0, stream>>>(input, update, {}, nullptr);
  });
  CheckCuda(cudaGetLastError(), "colours' optimiser");
}

}  // namespace s2gs::cuda
