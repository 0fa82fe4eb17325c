#include <algorithm>
#include <cfloat>
#include <iterator>
#include <type_traits>

#include "s2gs/core/cuda.h"
#include "s2gs/cuda/colors.h"
#include "s2gs/kernel/sh.h"

namespace s2gs::cuda {
namespace {

constexpr int kThreads = 128;
// Blocks of a multiprocessor, each of which goes through many chunks of kThreads Gaussians. With three the
// kernel is faster by itself, but leaves the sorts beside too few registers.
constexpr int kBlocks = 2;
constexpr int kBlocksOfRegisters = 4;  // there would be registers for so many.

template <int kDegree>
constexpr int kRestCount = ShRestCount(kDegree);

// The class of the log that a chunk belongs to.
__device__ int ClassOf(int chunk) { return chunk % kColorLogSize; }

__device__ Vec3<float> LoadThree(const Planes& planes, int plane, int i) {
  return {planes.At(plane)[i], planes.At(plane + 1)[i], planes.At(plane + 2)[i]};
}

// Gradients of the updates that a block's Gaussians lack, a column a thread.
struct MissingUpdates {
  float values[kColorLogSize][kPlanesOfSlot][kThreads];

  // \param first  of the updates. \return  a bit for each that the thread's Gaussian learns from.
  __device__ unsigned Load(const ColorInput& in, const ColorUpdates& log, int first, int i) {
    unsigned learnt = 0;
#pragma unroll
    for (int u = 0; u < kColorLogSize; ++u) {
      if (u < first || u >= log.size) continue;
      const ColorUpdate& update = log.updates[u];
      const Planes slot = ColorSlot(in.scratch, update.slot);
#pragma unroll
      for (int k = 0; k < kPlanesOfSlot; ++k) values[u][k][threadIdx.x] = slot.At(k)[i];
      const bool is_left = update.tile_counts != nullptr && update.tile_counts[i] == 0;
      if (in.is_skipped[update.slot] == 0 && !is_left) learnt |= 1U << u;
    }
    return learnt;
  }
  __device__ float ByColor(int update, int channel) const {
    return values[update][kByColor + channel][threadIdx.x];
  }
  __device__ Vec3<float> Direction(int update) const {
    const auto at = [&](int k) { return values[update][kViewDirection + k][threadIdx.x]; };
    return {at(0), at(1), at(2)};
  }
};

// One channel's coefficients of bands 1 to 3 of one Gaussian, and their moments.
template <int kCount>
struct Coefficients {
  static constexpr int kRoom = kCount > 0 ? kCount : 1;
  float x[kRoom], m[kRoom], v[kRoom];

  // Arrays of numbers that are read once: they leave the cache to what is read again.
  __device__ void Load(const ColorInput& in, int channel, int i, bool with_moments) {
    const size_t next = 3 * in.parameters.stride;  // from a coefficient's plane to the next one's
    const float* from = in.parameters.At(kShRest + channel) + i;
#pragma unroll
    for (int k = 0; k < kCount; ++k) x[k] = __ldcs(from + k * next);
    if (!with_moments) return;
    from = in.first_moments.At(kShRest + channel) + i;
#pragma unroll
    for (int k = 0; k < kCount; ++k) m[k] = __ldcs(from + k * next);
    from = in.second_moments.At(kShRest + channel) + i;
#pragma unroll
    for (int k = 0; k < kCount; ++k) v[k] = __ldcs(from + k * next);
  }
  __device__ void Store(const ColorInput& in, int channel, int i) const {
    const size_t next = 3 * in.parameters.stride;
    float* to = in.parameters.At(kShRest + channel) + i;
#pragma unroll
    for (int k = 0; k < kCount; ++k) __stcs(to + k * next, x[k]);
    to = in.first_moments.At(kShRest + channel) + i;
#pragma unroll
    for (int k = 0; k < kCount; ++k) __stcs(to + k * next, m[k]);
    to = in.second_moments.At(kShRest + channel) + i;
#pragma unroll
    for (int k = 0; k < kCount; ++k) __stcs(to + k * next, v[k]);
  }
  // \param basis  finite.
  __device__ void Learn(const ColorUpdate& update, float by_color, const float* basis) {
    // As BoundedGradient() of each product, with two operations for its four.
    constexpr auto kMax = static_cast<float>(kMaxAdamGradient);
    const float finite = isnan(by_color) ? 0 : fminf(fmaxf(by_color, -FLT_MAX), FLT_MAX);
#pragma unroll
    for (int k = 0; k < kCount; ++k) {
      const float gradient = fminf(fmaxf(finite * basis[k], -kMax), kMax);
      UpdateByBounded(update.adam, update.rate, gradient, &x[k], &m[k], &v[k]);
    }
  }
};

template <int kDegree, bool kDraws>
__global__ __launch_bounds__(kThreads,
                             kBlocksOfRegisters) void ColorKernel(const __grid_constant__ ColorInput in,
                                                                  const __grid_constant__ ColorUpdates log,
                                                                  const __grid_constant__ ProjectOptions view,
                                                                  PackedSplat* splats, uint8_t* traits) {
  constexpr int kCount = kRestCount<kDegree>;
  __shared__ MissingUpdates missing;
  const auto count = static_cast<int>(in.count);
#pragma unroll 1
  for (auto chunk = static_cast<int>(blockIdx.x); chunk * kThreads < count;
       chunk += static_cast<int>(gridDim.x)) {
    const int i = chunk * kThreads + static_cast<int>(threadIdx.x);
    if (i >= count) continue;
    const int its_class = ClassOf(chunk);
    const int first = log.size - log.num_missing[its_class];
    const unsigned learnt = missing.Load(in, log, first, i);
    const bool is_written = learnt != 0 && (!kDraws || its_class == log.written);
    if (!kDraws && !is_written) continue;
    Vec3<float> direction{};
    float basis[Coefficients<kCount>::kRoom];
    float4 packed{};  // opacity and colour
    if constexpr (kDraws) {
      packed.x = Sigmoid(in.parameters.At(kOpacity)[i]);
      const float logit = in.parameters.At(kForeground)[i];
      const bool is_foreground = IsForeground(logit, view.rule);
      const float p = ForegroundProbability(logit, view.rule);
      direction = ViewDirection(
          CentreInCamera(LoadThree(in.parameters, kCentre, i), p, is_foreground, view.camera, view.rule),
          is_foreground, view.camera);
      ShRestBasis(kDegree, direction, basis);
    }
#pragma unroll 1
    for (int channel = 0; channel < 3; ++channel) {
      Coefficients<kCount> c;
      c.Load(in, channel, i, learnt != 0);
#pragma unroll 1
      for (int u = first; u < log.size; ++u) {
        if ((learnt >> u & 1U) == 0) continue;
        float basis_then[Coefficients<kCount>::kRoom];
        ShRestBasis(kDegree, missing.Direction(u), basis_then);
        c.Learn(log.updates[u], missing.ByColor(u, channel), basis_then);
      }
      if (is_written) c.Store(in, channel, i);
      if constexpr (kDraws) {
        float color = 0.5F + static_cast<float>(kShBand0) * in.parameters.At(kShDc + channel)[i];
#pragma unroll
        for (int k = 0; k < kCount; ++k) color += basis[k] * c.x[k];
        // Not a number stays what it is, for IsDrawableColor.
        color = color < 0 ? 0 : color;
        if (channel == 0) packed.y = color;
        if (channel == 1) packed.z = color;
        if (channel == 2) packed.w = color;
        if constexpr (kDegree > 0) {
          const Vec3<float> by_direction = ShRestBasisAdjoint(kDegree, direction, c.x);
          float* const out = in.scratch.At(kColorByDirection + 3 * channel) + i;
          out[0] = by_direction.x;
          out[in.scratch.stride] = by_direction.y;
          out[2 * in.scratch.stride] = by_direction.z;
        }
      }
    }
    if constexpr (kDraws) {
      splats[i].c = packed;
      const Vec3<float> color = {packed.y, packed.z, packed.w};
      traits[i] =
          static_cast<uint8_t>((color.x > 0 ? kRedIsLit : 0) | (color.y > 0 ? kGreenIsLit : 0) |
                               (color.z > 0 ? kBlueIsLit : 0) | (IsDrawableColor(color) ? kIsDrawable : 0));
    }
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

unsigned Grid(const ColorInput& input) {
  return std::min(NumBlocks(input.count, kThreads), static_cast<unsigned>(input.num_processors * kBlocks));
}

}  // namespace

void ColorLog::Add(const ColorUpdate& update, int sh_degree) {
  ColorUpdates& all = updates_;
  S2GS_INVARIANT(update.slot == next_slot_ && (IsEmpty() || all.sh_degree == sh_degree));
  Forget();
  S2GS_INVARIANT(all.size < kColorLogSize);
  all.sh_degree = sh_degree;
  all.updates[all.size++] = update;
  for (int& num_missing : all.num_missing) ++num_missing;
  next_slot_ = (next_slot_ + 1) % kColorLogSize;
}

void ColorLog::WroteOne() {
  updates_.num_missing[updates_.written] = 0;
  updates_.written = (updates_.written + 1) % kColorLogSize;
}

void ColorLog::WroteAll() {
  for (int& num_missing : updates_.num_missing) num_missing = 0;
  updates_.size = 0;
}

// The updates that no class lacks any more.
void ColorLog::Forget() {
  const int kept = *std::max_element(std::begin(updates_.num_missing), std::end(updates_.num_missing));
  for (int i = 0; i < kept; ++i) updates_.updates[i] = updates_.updates[updates_.size - kept + i];
  updates_.size = kept;
}

void DrawColors(const ColorInput& input, const ColorUpdates& updates, const ProjectOptions& view,
                PackedSplat* splats, uint8_t* traits, cudaStream_t stream) {
  if (input.count == 0) return;
  S2GS_INVARIANT(updates.size == 0 || updates.sh_degree == view.sh_degree);
  WithDegree(view.sh_degree, [&](auto degree) {
    ColorKernel<decltype(degree)::value, true>
        <<<Grid(input), kThreads, 0, stream>>>(input, updates, view, splats, traits);
  });
  CheckCuda(cudaGetLastError(), "colours");
}

void LearnColors(const ColorInput& input, const ColorUpdates& updates, cudaStream_t stream) {
  if (input.count == 0 || updates.size == 0 || updates.sh_degree == 0) return;
  WithDegree(updates.sh_degree, [&](auto degree) {
    ColorKernel<decltype(degree)::value, false>
        <<<Grid(input), kThreads, 0, stream>>>(input, updates, {}, nullptr, nullptr);
  });
  CheckCuda(cudaGetLastError(), "colours' optimiser");
}

}  // namespace s2gs::cuda
