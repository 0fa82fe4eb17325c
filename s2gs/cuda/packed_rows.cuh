#pragma once

#include <cuda_pipeline.h>

#include "s2gs/cuda/device_data.h"

namespace s2gs::cuda {

/// Rows of a PackedSplat's layout between global memory and a block's threads, one row a thread. A warp's
/// rows go through shared memory, so that each access is of whole lines: four of 16 bytes a row, 64 bytes
/// apart, are halves of the memory's sectors, and take four times as long. All lanes must call each function.
template <int kThreads>
struct PackedRows {
  // Rows are padded so that lanes that stand for rows use different banks.
  float4 values[kThreads][5];

  /// Sends for the rows of those lanes whose bit is set. \param first  the warp's first row.
  __device__ void Load(const float4* first, unsigned wanted) {
    ForEachPart([&](unsigned row, unsigned part, unsigned at) {
      if ((wanted >> row & 1U) != 0) {
        __pipeline_memcpy_async(&values[WarpBegin() + row][part], first + at, sizeof(float4));
      }
    });
    __pipeline_commit();
  }
  /// Waits for all that the thread sent for.
  __device__ static void Wait() {
    __pipeline_wait_prior(0);
    __syncwarp();
  }

  __device__ void Put(const PackedSplat& row) {
    float4* const own = values[threadIdx.x];
    own[0] = row.a;
    own[1] = row.b;
    own[2] = row.c;
    own[3] = row.d;
    __syncwarp();
  }
  __device__ PackedSplat Get() const {
    const float4* const own = values[threadIdx.x];
    return {own[0], own[1], own[2], own[3]};
  }

  /// \param parts  of a row: a bit for each 16 bytes.
  __device__ void Store(float4* first, unsigned wanted, unsigned parts) const {
    ForEachPart([&](unsigned row, unsigned part, unsigned at) {
      if ((wanted >> row & 1U) != 0 && (parts >> part & 1U) != 0) first[at] = values[WarpBegin() + row][part];
    });
  }
  __device__ static void StoreZeros(float4* first, unsigned wanted) {
    ForEachPart([&](unsigned row, unsigned /*part*/, unsigned at) {
      if ((wanted >> row & 1U) != 0) first[at] = {0, 0, 0, 0};
    });
  }

 private:
  __device__ static unsigned WarpBegin() { return threadIdx.x / 32 * 32; }

  template <typename Run>
  __device__ static void ForEachPart(const Run& run) {
#pragma unroll
    for (unsigned i = 0; i < 4; ++i) {
      const unsigned at = i * 32 + threadIdx.x % 32;
      run(at / 4, at % 4, at);
    }
  }
};

}  // namespace s2gs::cuda
