#pragma once

#include <cuda_pipeline.h>

#include "s2gs/cuda/device_data.h"
#include "s2gs/kernel/sh.h"

namespace s2gs::cuda {

/// Coefficients of bands 1 to kDegree of a block's Gaussians on their way to shared memory, one Gaussian a
/// thread: so many loads at once would take more registers than a kernel can spare. A thread reads what it
/// loaded itself.
template <int kDegree, int kThreads>
struct ShAhead {
  static constexpr int kCount = 3 * ShRestCount(kDegree);
  float values[kCount > 0 ? kCount : 1][kThreads];

  __device__ void Load(const Planes& parameters, int i) {
#pragma unroll
    for (int k = 0; k < kCount; ++k) {
      __pipeline_memcpy_async(&values[k][threadIdx.x], parameters.At(kShRest + k) + i, sizeof(float));
    }
    __pipeline_commit();
  }
  __device__ static void Wait() { __pipeline_wait_prior(0); }

  __device__ float At(int k, int channel) const { return values[3 * k + channel][threadIdx.x]; }
};

}  // namespace s2gs::cuda
