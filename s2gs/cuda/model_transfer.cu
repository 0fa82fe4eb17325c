#include <array>

#include "s2gs/cuda/model_transfer.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/parallel_for.h"

namespace s2gs::cuda {
namespace {

// The arrays of Gaussians, in the order of the planes.
struct Field {
  std::vector<float> Gaussians::*values;
  int first_plane;
  int num_planes;
};
constexpr std::array<Field, 7> kFields = {{{&Gaussians::centre, kCentre, 3},
                                           {&Gaussians::log_scale, kLogScale, 2},
                                           {&Gaussians::rotation, kRotation, 4},
                                           {&Gaussians::opacity_logit, kOpacity, 1},
                                           {&Gaussians::foreground_logit, kForeground, 1},
                                           {&Gaussians::sh_dc, kShDc, 3},
                                           {&Gaussians::sh_rest, kShRest, 3 * kShRestPerChannel}}};

constexpr int64_t kRowsAtOnce = 4096;

__global__ void ClampOpacityKernel(float* logits, float* first_moments, float* second_moments, int count,
                                   float max_logit) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i >= count) return;
  if (logits[i] > max_logit) logits[i] = max_logit;
  first_moments[i] = 0;
  second_moments[i] = 0;
}

__global__ void ReplaceForegroundKernel(const float* replacements, float* logits, float* first_moments,
                                        float* second_moments, int count) {
  const int i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i >= count || logits[i] == replacements[i]) return;
  logits[i] = replacements[i];
  first_moments[i] = 0;
  second_moments[i] = 0;
}

}  // namespace

void UploadGaussians(const Gaussians& gaussians, size_t count, const Planes& planes, cudaStream_t stream) {
  if (gaussians.empty()) {
    CheckCuda(cudaMemsetAsync(planes.data, 0, sizeof(float) * kNumPlanes * planes.stride, stream), "state");
    return;
  }
  std::vector<float> plane(count);
  for (const Field& field : kFields) {
    const std::vector<float>& values = gaussians.*field.values;
    const auto per_row = static_cast<size_t>(field.num_planes);
    S2GS_INVARIANT(values.size() == per_row * count);
    for (size_t k = 0; k < per_row; ++k) {
      for (size_t i = 0; i < count; ++i) plane[i] = values[i * per_row + k];
      CheckCuda(cudaMemcpyAsync(planes.At(field.first_plane + static_cast<int>(k)), plane.data(),
                                count * sizeof(float), cudaMemcpyHostToDevice, stream),
                "state");
      CheckCuda(cudaStreamSynchronize(stream), "computation");
    }
  }
}

Gaussians DownloadGaussians(const Planes& planes, size_t count, cudaStream_t stream) {
  Gaussians gaussians;
  gaussians.Resize(count);
  for (const Field& field : kFields) {
    const auto per_row = static_cast<size_t>(field.num_planes);
    std::vector<float>& values = gaussians.*field.values;
    std::vector<std::vector<float>> columns;
    for (size_t k = 0; k < per_row; ++k)
      columns.push_back(DownloadArray(planes.At(field.first_plane + static_cast<int>(k)), count, stream));
    ParallelFor(static_cast<int64_t>(count), 0, kRowsAtOnce, [&](int64_t row) {
      float* const to = values.data() + static_cast<size_t>(row) * per_row;
      for (size_t k = 0; k < per_row; ++k) to[k] = columns[k][static_cast<size_t>(row)];
    });
  }
  return gaussians;
}

void ClampOpacity(const Planes& parameters, const Planes& first_moments, const Planes& second_moments,
                  int64_t count, float max_logit, cudaStream_t stream) {
  ClampOpacityKernel<<<NumBlocks(count, 256), 256, 0, stream>>>(
      parameters.At(kOpacity), first_moments.At(kOpacity), second_moments.At(kOpacity),
      static_cast<int>(count), max_logit);
  CheckCuda(cudaGetLastError(), "opacity reset");
}

void ReplaceForeground(const float* replacements, const Planes& parameters, const Planes& first_moments,
                       const Planes& second_moments, int64_t count, cudaStream_t stream) {
  ReplaceForegroundKernel<<<NumBlocks(count, 256), 256, 0, stream>>>(
      replacements, parameters.At(kForeground), first_moments.At(kForeground), second_moments.At(kForeground),
      static_cast<int>(count));
  CheckCuda(cudaGetLastError(), "foreground");
}

}  // namespace s2gs::cuda
