#pragma once

#include <chrono>

namespace s2gs {

/// A clock that nobody sets, for differences [s].
inline double SteadySeconds() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

}  // namespace s2gs
