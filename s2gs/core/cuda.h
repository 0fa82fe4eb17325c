#pragma once

#include <cuda_runtime.h>

#include <cstddef>
#include <string>
#include <utility>

#include "sfm_split/base/error.h"

namespace s2gs {

/// Throws UserError when a call of the CUDA runtime failed.
inline void CheckCuda(cudaError_t error, const char* what) {
  if (error == cudaSuccess) return;
  cudaGetLastError();  // Clears errors that are not sticky.
  if (error == cudaErrorMemoryAllocation) {
    throw UserError(std::string("The GPU is out of memory (") + what +
                    "). Use fewer Gaussians, a smaller image size, or a GPU with more memory");
  }
  throw UserError(std::string("The GPU reports: ") + cudaGetErrorString(error) + " (" + what + ")");
}

/// How much memory all buffers hold, for BackendInfo.
struct DeviceMemoryCount {
  int64_t bytes = 0;
  int64_t peak_bytes = 0;
};

/// An array in the GPU's memory. Grows, never shrinks.
template <typename T>
class DeviceBuffer {
 public:
  explicit DeviceBuffer(DeviceMemoryCount* count) : count_(count) {}
  DeviceBuffer(const DeviceBuffer&) = delete;
  DeviceBuffer& operator=(const DeviceBuffer&) = delete;
  ~DeviceBuffer() { Free(); }

  T* get() const { return data_; }
  size_t capacity() const { return capacity_; }

  /// Room for `size` elements. Contents are lost when it has to grow. Waits for the GPU then.
  void Reserve(size_t size) {
    if (size <= capacity_) return;
    Free();
    CheckCuda(cudaMalloc(&data_, size * sizeof(T)), "cudaMalloc");
    capacity_ = size;
    count_->bytes += static_cast<int64_t>(size * sizeof(T));
    if (count_->bytes > count_->peak_bytes) count_->peak_bytes = count_->bytes;
  }

  void Swap(DeviceBuffer& other) {
    std::swap(data_, other.data_);
    std::swap(capacity_, other.capacity_);
  }

  void Free() {
    if (data_ != nullptr) cudaFree(data_);
    count_->bytes -= static_cast<int64_t>(capacity_ * sizeof(T));
    data_ = nullptr;
    capacity_ = 0;
  }

 private:
  DeviceMemoryCount* count_;
  T* data_ = nullptr;
  size_t capacity_ = 0;
};

inline unsigned NumBlocks(int64_t count, int threads) {
  return static_cast<unsigned>((count + threads - 1) / threads);
}

}  // namespace s2gs
