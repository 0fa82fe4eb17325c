#pragma once

#include <chrono>

namespace s2gs {

/// A clock that nobody sets, for differences [s].
inline double SteadySeconds() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

/// Time since it was made, or since its last lap.
class Stopwatch {
 public:
  double Lap() {  ///< [s]; starts the next one.
    const double start = start_;
    start_ = SteadySeconds();
    return start_ - start;
  }

 private:
  double start_ = SteadySeconds();
};

}  // namespace s2gs
