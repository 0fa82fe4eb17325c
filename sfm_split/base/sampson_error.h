#pragma once

#include <Eigen/Core>
#include <cmath>

namespace s2gs {

/// Sampson's error of two points x1, x2 (third coordinate 1) that ought to satisfy x2^T F x1 = 0: to first
/// order the distance, over both images, to the nearest two that do; signed, in the unit of the points. That
/// is the distance of either from its line over the square root of 2 where both lines are as steep. 1e6,
/// beyond any bound, where there are no lines (two images of one place): nothing to agree with. \param line1
/// F^T x2. \param line2  F x1.
template <typename T>
T SampsonError(const Eigen::Matrix<T, 3, 1>& line1, const Eigen::Matrix<T, 3, 1>& line2,
               const Eigen::Vector3d& x2) {
  using std::sqrt;
  const T squared = line2(0) * line2(0) + line2(1) * line2(1) + (line1(0) * line1(0) + line1(1) * line1(1));
  // Lines are of the order of the baseline over the depth: this is rounding.
  if (!(squared > T(1e-30))) return T(1e6);
  return (line2(0) * x2(0) + (line2(1) * x2(1) + line2(2) * x2(2))) / sqrt(squared);
}

template <typename T>
T SampsonError(const Eigen::Matrix<T, 3, 3>& F, const Eigen::Vector3d& x1, const Eigen::Vector3d& x2) {
  using V = Eigen::Matrix<T, 3, 1>;
  return SampsonError<T>(V(F.transpose() * x2.cast<T>()), V(F * x1.cast<T>()), x2);
}

}  // namespace s2gs
