#include <cuda_runtime.h>

#include "s2gs/core/gpu_info.h"

namespace s2gs {
namespace {

constexpr int kNumThreads = 64;

__global__ void SquareIndices(int* out) { out[threadIdx.x] = static_cast<int>(threadIdx.x * threadIdx.x); }

// Returns why the current device cannot run this program's kernels, or an empty string.
std::string TryKernel() {
  int* device = nullptr;
  cudaError_t error = cudaMalloc(&device, kNumThreads * sizeof(int));
  if (error != cudaSuccess) return cudaGetErrorString(error);
  int host[kNumThreads] = {};
  SquareIndices<<<1, kNumThreads>>>(device);
  error = cudaGetLastError();
  if (error == cudaSuccess) error = cudaMemcpy(host, device, sizeof(host), cudaMemcpyDeviceToHost);
  cudaFree(device);
  if (error != cudaSuccess) return cudaGetErrorString(error);
  for (int i = 0; i < kNumThreads; ++i) {
    if (host[i] != i * i) return "a test kernel gave a wrong result";
  }
  return "";
}

}  // namespace

std::string BuiltWithCuda() {
  return std::to_string(CUDART_VERSION / 1000) + "." + std::to_string(CUDART_VERSION % 1000 / 10);
}

std::vector<GpuInfo> ListGpus() {
  std::vector<GpuInfo> gpus;
  int count = 0;
  if (cudaGetDeviceCount(&count) != cudaSuccess) return gpus;
  // Who asks may be at work on one of them.
  int current = 0;
  if (cudaGetDevice(&current) != cudaSuccess) current = 0;
  for (int i = 0; i < count; ++i) {
    cudaDeviceProp properties;
    if (cudaGetDeviceProperties(&properties, i) != cudaSuccess) continue;
    GpuInfo gpu;
    gpu.index = i;
    gpu.name = properties.name;
    gpu.compute_major = properties.major;
    gpu.compute_minor = properties.minor;
    gpu.memory_bytes = properties.totalGlobalMem;
    const cudaError_t error = cudaSetDevice(i);
    gpu.problem = error == cudaSuccess ? TryKernel() : cudaGetErrorString(error);
    gpu.is_usable = gpu.problem.empty();
    gpus.push_back(gpu);
  }
  if (count > 0) cudaSetDevice(current);
  return gpus;
}

}  // namespace s2gs
