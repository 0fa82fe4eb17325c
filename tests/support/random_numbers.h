#pragma once

#include <Eigen/Core>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "sfm_split/base/angles.h"

namespace s2gs {

/// Random numbers that are the same on every platform and standard library, unlike std's distributions.
/// Numbers of different streams of one seed are independent, so that, say, more noise moves no point.
class RandomNumbers {
 public:
  explicit RandomNumbers(uint64_t seed, uint64_t stream = 0) : state_(Mix(seed) ^ Mix(~stream)) {}

  /// SplitMix64.
  uint64_t Next() {
    state_ += 0x9e3779b97f4a7c15ULL;
    return Mix(state_);
  }
  /// In [0, 1).
  double Uniform() { return static_cast<double>(Next() >> 11) * 0x1p-53; }
  double Uniform(double from, double to) { return from + (to - from) * Uniform(); }
  /// Below `count`, which must be positive.
  size_t Index(size_t count) { return static_cast<size_t>(Next() % count); }
  /// Of mean 0 and variance 1 (Box-Muller).
  double Normal() {
    const double radius = std::sqrt(-2 * std::log(1 - Uniform()));
    return radius * std::cos(2 * kPi * Uniform());
  }
  /// Uniformly distributed over the unit sphere.
  Eigen::Vector3d Direction() {
    const double z = Uniform(-1, 1);
    const double phi = Uniform(0, 2 * kPi);
    const double r = std::sqrt(1 - z * z);
    return {r * std::cos(phi), r * std::sin(phi), z};
  }
  template <typename T>
  void Shuffle(std::vector<T>* values) {
    for (size_t i = values->size(); i > 1; --i) std::swap((*values)[i - 1], (*values)[Index(i)]);
  }

 private:
  static uint64_t Mix(uint64_t x) {
    x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9ULL;
    x = (x ^ (x >> 27)) * 0x94d049bb133111ebULL;
    return x ^ (x >> 31);
  }

  uint64_t state_;
};

}  // namespace s2gs
