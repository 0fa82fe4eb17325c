#pragma once

#include <array>
#include <cmath>

#include "s2gs/core/vec.h"
#include "s2gs/kernel/sh.h"

namespace s2gs {

/// The Wigner D matrices of bands 1 to 3 in the real basis of sh.h: for a rotation R and every unit vector d,
/// basis(R d) = D(R) basis(d). A radiance function with coefficients c, turned by R, has coefficients D(R) c;
/// this is the transform of (9) for colours. Training turns the view direction instead, which gives the same
/// colours for less work; files of models turned to another pose need D.
template <typename T>
class WignerD {
 public:
  explicit WignerD(const Mat3<T>& rotation) {
    // D_l = integral of basis(R d) basis(d)^T over the sphere. Gauss-Legendre over z times equal steps about
    // z integrates polynomials of degree 6 exactly, which the products of two bands are at most.
    constexpr double kNodes[4] = {-0.8611363115940526, -0.3399810435848563, 0.3399810435848563,
                                  0.8611363115940526};
    constexpr double kWeights[4] = {0.3478548451374538, 0.6521451548625461, 0.6521451548625461,
                                    0.3478548451374538};
    constexpr int kSteps = 7;
    constexpr double kTwoPi = 6.283185307179586;
    for (auto& row : d_) row.fill(T(0));
    for (int i = 0; i < 4; ++i) {
      const double ring = std::sqrt(1 - kNodes[i] * kNodes[i]);
      for (int step = 0; step < kSteps; ++step) {
        const double angle = kTwoPi * step / kSteps;
        const Vec3<T> direction = {T(ring * std::cos(angle)), T(ring * std::sin(angle)), T(kNodes[i])};
        T plain[kShRestPerChannel], turned[kShRestPerChannel];
        ShRestBasis(3, direction, plain);
        ShRestBasis(3, rotation * direction, turned);
        const T weight(kWeights[i] * kTwoPi / kSteps);
        for (int row = 0; row < kShRestPerChannel; ++row) {
          for (int column = 0; column < kShRestPerChannel; ++column) {
            if (Band(row) == Band(column)) d_[row][column] += weight * turned[row] * plain[column];
          }
        }
      }
    }
  }

  /// Element of the block-diagonal 15 x 15 matrix.
  const T& operator()(int row, int column) const { return d_[row][column]; }

  /// Turns the coefficients of one channel, of all bands from 1.
  std::array<T, kShRestPerChannel> operator*(const std::array<T, kShRestPerChannel>& coefficients) const {
    std::array<T, kShRestPerChannel> result;
    for (int row = 0; row < kShRestPerChannel; ++row) {
      T sum(0);
      for (int column = 0; column < kShRestPerChannel; ++column)
        sum += d_[row][column] * coefficients[column];
      result[row] = sum;
    }
    return result;
  }

 private:
  static int Band(int index) { return index < 3 ? 1 : index < 8 ? 2 : 3; }

  std::array<std::array<T, kShRestPerChannel>, kShRestPerChannel> d_;
};

}  // namespace s2gs
