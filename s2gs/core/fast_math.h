#pragma once

#include <cmath>
#include <type_traits>

#include "s2gs/core/host_device.h"

namespace s2gs {

/// e^x, 1 / x and a / b by the GPU's own approximations (about 2 units in the last place) where the code runs
/// on one in float; elsewhere the exact functions. For the inner loops over pixels and parameters.
template <typename T>
S2GS_HD inline T FastExp(const T& x) {
#if defined(__CUDA_ARCH__)
  if constexpr (std::is_same_v<T, float>) return __expf(x);
#endif
  using std::exp;
  return exp(x);
}

template <typename T>
S2GS_HD inline T FastReciprocal(const T& x) {
#if defined(__CUDA_ARCH__)
  if constexpr (std::is_same_v<T, float>) return __fdividef(1.0F, x);
#endif
  return T(1) / x;
}

/// \param b  below 2^126.
template <typename T>
S2GS_HD inline T FastQuotient(const T& a, const T& b) {
#if defined(__CUDA_ARCH__)
  if constexpr (std::is_same_v<T, float>) return __fdividef(a, b);
#endif
  return a / b;
}

}  // namespace s2gs
