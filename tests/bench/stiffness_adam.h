#pragma once

#include <cmath>
#include <cstdint>
#include <vector>

#include "s2gs/core/host_device.h"
#include "s2gs/kernel/adam.h"

namespace s2gs {

/// Sizes from 1 down to 1 / span, each started three times too large; the loss is the mean of
/// (size / truth - 1)^2, as a picture's, which sees sizes relative to what they should be. No size
/// depends on another: the condition number of the loss's Hessian is span^2 in sizes and 1 in logarithms.
struct AdamProblem {
  static constexpr int kCount = 61;
  double span = 1;
  bool logarithmic = false;  ///< the parameter is the size's logarithm.
  bool adam = false;         ///< otherwise gradient descent.
  double rate = 0;
  int iterations = 0;

  double Truth(int i) const { return std::pow(span, -static_cast<double>(i) / (kCount - 1)); }
};

/// One parameter after `iterations` steps from `x`. \param steps  one an iteration.
template <typename T>
S2GS_HD T FitSize(T truth, T x, bool logarithmic, bool adam, T rate, int iterations,
                  const AdamStep<T>* steps) {
  using std::exp;
  T m = 0, v = 0;
  for (int t = 0; t < iterations; ++t) {
    const T ratio = (logarithmic ? exp(x) : x) / truth;
    const T by_size = T(2) * (ratio - T(1)) / truth / T(AdamProblem::kCount);
    const T gradient = logarithmic ? by_size * ratio * truth : by_size;
    if (adam) {
      UpdateByAdam(steps[t], rate, gradient, &x, &m, &v);
    } else {
      x -= rate * gradient;
    }
  }
  return x;
}

/// The parameters that FitSize<float> ends at on the GPU, compiled as training's own update is. Empty
/// where the CUDA backend was not built or there is no GPU.
std::vector<float> FitSizesOnGpu(const AdamProblem& problem);

}  // namespace s2gs
