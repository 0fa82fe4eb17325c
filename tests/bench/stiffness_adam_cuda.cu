#include "tests/bench/stiffness_adam.h"

namespace s2gs {
namespace {

__global__ void FitSizes(bool logarithmic, bool adam, float rate, int iterations, const float* truth,
                         const AdamStep<float>* steps, float* x) {
  const int i = static_cast<int>(threadIdx.x);
  if (i < AdamProblem::kCount) {
    x[i] = FitSize<float>(truth[i], x[i], logarithmic, adam, rate, iterations, steps);
  }
}

template <typename T>
T* OnDevice(const std::vector<T>& values) {
  T* copy = nullptr;
  if (cudaMalloc(&copy, values.size() * sizeof(T)) != cudaSuccess) return nullptr;
  cudaMemcpy(copy, values.data(), values.size() * sizeof(T), cudaMemcpyHostToDevice);
  return copy;
}

}  // namespace

std::vector<float> FitSizesOnGpu(const AdamProblem& problem) {
  std::vector<float> truth, x;
  for (int i = 0; i < AdamProblem::kCount; ++i) {
    truth.push_back(static_cast<float>(problem.Truth(i)));
    x.push_back(
        static_cast<float>(problem.logarithmic ? std::log(3 * problem.Truth(i)) : 3 * problem.Truth(i)));
  }
  std::vector<AdamStep<float>> steps;
  for (int t = 1; t <= problem.iterations; ++t) steps.push_back(MakeAdamStep<float>(t));
  float* const truth_on_device = OnDevice(truth);
  float* const x_on_device = OnDevice(x);
  AdamStep<float>* const steps_on_device = OnDevice(steps);
  bool ran = truth_on_device != nullptr && x_on_device != nullptr && steps_on_device != nullptr;
  if (ran) {
    FitSizes<<<1, 64>>>(problem.logarithmic, problem.adam, static_cast<float>(problem.rate),
                        problem.iterations, truth_on_device, steps_on_device, x_on_device);
    ran = cudaMemcpy(x.data(), x_on_device, x.size() * sizeof(float), cudaMemcpyDeviceToHost) == cudaSuccess;
  }
  cudaFree(truth_on_device);
  cudaFree(x_on_device);
  cudaFree(steps_on_device);
  return ran ? x : std::vector<float>();
}

}  // namespace s2gs
