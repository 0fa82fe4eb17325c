#pragma once

#include <cmath>
#include <cstdint>

#include "s2gs/core/fast_math.h"
#include "s2gs/core/host_device.h"

namespace s2gs {

constexpr double kAdamBeta1 = 0.9;
constexpr double kAdamBeta2 = 0.999;
constexpr double kAdamEpsilon = 1e-15;

/// What one iteration's updates share. Filled on the host, in double.
template <typename T>
struct AdamStep {
  T first_correction;   ///< 1 / (1 - beta1^t)
  T second_correction;  ///< 1 / sqrt(1 - beta2^t)
};

/// \param iteration  from 1.
template <typename T>
inline AdamStep<T> MakeAdamStep(int64_t iteration) {
  const auto t = static_cast<double>(iteration);
  return {T(1 / (1 - std::pow(kAdamBeta1, t))), T(1 / std::sqrt(1 - std::pow(kAdamBeta2, t)))};
}

/// A gradient that is not finite counts as zero, and one whose square would overflow is cut, so that moments
/// stay finite.
constexpr double kMaxAdamGradient = 1e15;
template <typename T>
S2GS_HD inline T BoundedGradient(T gradient) {
  constexpr double kMax = kMaxAdamGradient;
  if (!(gradient <= T(kMax))) gradient = gradient > T(0) ? T(kMax) : T(0);
  if (!(gradient >= T(-kMax))) gradient = T(-kMax);
  return gradient;
}

/// One parameter's update by Adam (Kingma and Ba, 2015). \param gradient  a bounded one.
template <typename T>
S2GS_HD inline void UpdateByBounded(const AdamStep<T>& step, T rate, T gradient, T* parameter,
                                    T* first_moment, T* second_moment) {
  using std::sqrt;
  const T m = *first_moment + T(1 - kAdamBeta1) * (gradient - *first_moment);
  const T v = *second_moment + T(1 - kAdamBeta2) * (gradient * gradient - *second_moment);
  *first_moment = m;
  *second_moment = v;
  const T divisor = sqrt(v) * step.second_correction + T(kAdamEpsilon);
  *parameter -= FastQuotient(rate * (m * step.first_correction), divisor);
}

/// The same of any gradient.
template <typename T>
S2GS_HD inline void UpdateByAdam(const AdamStep<T>& step, T rate, T gradient, T* parameter, T* first_moment,
                                 T* second_moment) {
  UpdateByBounded(step, rate, BoundedGradient(gradient), parameter, first_moment, second_moment);
}

}  // namespace s2gs
