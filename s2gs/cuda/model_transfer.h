#pragma once

#include <vector>

#include "s2gs/core/cuda.h"
#include "s2gs/core/gaussians.h"
#include "s2gs/cuda/device_data.h"

namespace s2gs::cuda {

/// `size` values from the GPU. Waits for it.
template <typename T>
std::vector<T> DownloadArray(const T* data, size_t size, cudaStream_t stream) {
  std::vector<T> values(size);
  if (size == 0) return values;
  CheckCuda(cudaMemcpyAsync(values.data(), data, size * sizeof(T), cudaMemcpyDeviceToHost, stream),
            "download");
  CheckCuda(cudaStreamSynchronize(stream), "computation");
  return values;
}

/// Values to the GPU, in the stream's order: a plain cudaMemcpy goes to the default stream, returns when
/// pageable memory is staged and not when it has arrived, and no other stream waits for it. `values` must
/// live until the stream has come there.
template <typename T>
void UploadArray(const std::vector<T>& values, T* target, const char* what, cudaStream_t stream) {
  CheckCuda(cudaMemcpyAsync(target, values.data(), values.size() * sizeof(T), cudaMemcpyHostToDevice, stream),
            what);
}

/// `count` Gaussians, or as many rows of zeros where there are none, into planes. Waits for the GPU.
void UploadGaussians(const Gaussians& gaussians, size_t count, const Planes& planes, cudaStream_t stream);

/// The other way. sh_degree is left at its default.
Gaussians DownloadGaussians(const Planes& planes, size_t count, cudaStream_t stream);

/// Opacity logits above the bound are set to it; the moments of all become zero.
void ClampOpacity(const Planes& parameters, const Planes& first_moments, const Planes& second_moments,
                  int64_t count, float max_logit, cudaStream_t stream);

/// Foreground logits that differ from their replacement take its value, and their moments become zero.
/// \param replacements  `count` logits, on the GPU.
void ReplaceForeground(const float* replacements, const Planes& parameters, const Planes& first_moments,
                       const Planes& second_moments, int64_t count, cudaStream_t stream);

}  // namespace s2gs::cuda
