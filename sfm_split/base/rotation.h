#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <Eigen/SVD>
#include <cmath>
#include <limits>
#include <vector>

#include "sfm_split/base/angles.h"

namespace s2gs {

// Rotation vectors w = angle * unit axis [rad]. Functions templated on the scalar take double, float or
// ceres::Jet; branches look at values only, and each branch is smooth, so derivatives are finite everywhere,
// at w = 0 and at |w| = pi included. Below |w| = 0.1 truncated series replace quotients that cancel; their
// first omitted term is below 1e-17.

/// [v]x: CrossMatrix(v) * u == v.cross(u).
template <typename T>
Eigen::Matrix<T, 3, 3> CrossMatrix(const Eigen::Matrix<T, 3, 1>& v) {
  Eigen::Matrix<T, 3, 3> m;
  m << T(0), -v.z(), v.y(),  //
      v.z(), T(0), -v.x(),   //
      -v.y(), v.x(), T(0);
  return m;
}

namespace rotation_internal {

constexpr double kSeriesBelowSquaredAngle = 1e-2;  // [rad^2] below, the first term left out is under 1e-16

/// sin(t)/t, (1 - cos t)/t^2 and (t - sin t)/t^3 as functions of t^2.
template <typename T>
void RodriguesCoefficients(const T& squared_angle, T* a, T* b, T* c) {
  using std::cos;
  using std::sin;
  using std::sqrt;
  const T& s = squared_angle;
  if (s < T(kSeriesBelowSquaredAngle)) {
    *a = T(1) - s * (T(1.0 / 6) - s * (T(1.0 / 120) - s * (T(1.0 / 5040) - s * T(1.0 / 362880))));
    *b = T(0.5) - s * (T(1.0 / 24) - s * (T(1.0 / 720) - s * (T(1.0 / 40320) - s * T(1.0 / 3628800))));
    *c =
        T(1.0 / 6) - s * (T(1.0 / 120) - s * (T(1.0 / 5040) - s * (T(1.0 / 362880) - s * T(1.0 / 39916800))));
    return;
  }
  const T angle = sqrt(s);
  const T sine = sin(angle);
  const T half_sine = sin(T(0.5) * angle);
  *a = sine / angle;
  *b = T(2) * half_sine * half_sine / s;
  *c = (angle - sine) / (s * angle);
}

}  // namespace rotation_internal

/// Rodrigues' formula: exp([w]x) = I + a [w]x + b [w]x^2.
template <typename T>
Eigen::Matrix<T, 3, 3> ExpRotation(const Eigen::Matrix<T, 3, 1>& w) {
  T a;
  T b;
  T c;
  rotation_internal::RodriguesCoefficients(T(w.squaredNorm()), &a, &b, &c);
  const Eigen::Matrix<T, 3, 3> k = CrossMatrix(w);
  return Eigen::Matrix<T, 3, 3>::Identity() + a * k + b * (k * k);
}

/// The rotation vector of length <= pi of a unit quaternion (w, x, y, z); q and -q give the same rotation.
template <typename T>
Eigen::Matrix<T, 3, 1> LogQuaternion(const T& qw, const T& qx, const T& qy, const T& qz) {
  using std::atan2;
  using std::sqrt;
  const T sign = qw < T(0) ? T(-1) : T(1);
  const Eigen::Matrix<T, 3, 1> v(sign * qx, sign * qy, sign * qz);
  const T w = sign * qw;
  const T s = v.squaredNorm();
  if (s < T(2.5e-3)) {  // |v| = sin(angle / 2), so angle < 0.1; w is close to 1 here
    // 2 asin(|v|) / |v| from tan: 2 atan(u) / (u w) with u^2 = s / w^2.
    const T u = s / (w * w);
    const T series =
        T(1) - u * (T(1.0 / 3) - u * (T(0.2) - u * (T(1.0 / 7) - u * (T(1.0 / 9) - u * T(1.0 / 11)))));
    return (T(2) * series / w) * v;
  }
  const T norm = sqrt(s);
  return (T(2) * atan2(norm, w) / norm) * v;
}

/// The rotation vector of length <= pi of a rotation matrix. At pi either of the two signs.
template <typename T>
Eigen::Matrix<T, 3, 1> LogRotation(const Eigen::Matrix<T, 3, 3>& r) {
  using std::sqrt;
  // Shepperd's method: divide by the quaternion component that is largest, which is at least 1/2.
  const T trace = r(0, 0) + r(1, 1) + r(2, 2);
  int largest = 3;
  T best = trace;
  for (int i = 0; i < 3; ++i) {
    if (r(i, i) > best) {
      best = r(i, i);
      largest = i;
    }
  }
  if (largest == 3) {
    const T w2 = sqrt(T(1) + trace);  // 2 qw
    const T f = T(0.5) / w2;
    return LogQuaternion<T>(T(0.5) * w2, f * (r(2, 1) - r(1, 2)), f * (r(0, 2) - r(2, 0)),
                            f * (r(1, 0) - r(0, 1)));
  }
  const int i = largest;
  const int j = (i + 1) % 3;
  const int k = (i + 2) % 3;
  const T x2 = sqrt(T(1) + r(i, i) - r(j, j) - r(k, k));  // 2 q_i
  const T f = T(0.5) / x2;
  Eigen::Matrix<T, 3, 1> q;
  q(i) = T(0.5) * x2;
  q(j) = f * (r(j, i) + r(i, j));
  q(k) = f * (r(k, i) + r(i, k));
  return LogQuaternion<T>(f * (r(k, j) - r(j, k)), q(0), q(1), q(2));
}

/// J with exp(w + d) = exp(J d) exp(w) to first order in d. J(-w) is the right Jacobian.
template <typename T>
Eigen::Matrix<T, 3, 3> LeftJacobian(const Eigen::Matrix<T, 3, 1>& w) {
  T a;
  T b;
  T c;
  rotation_internal::RodriguesCoefficients(T(w.squaredNorm()), &a, &b, &c);
  const Eigen::Matrix<T, 3, 3> k = CrossMatrix(w);
  return Eigen::Matrix<T, 3, 3>::Identity() + b * k + c * (k * k);
}

/// A rotation by `angle` [rad] about the unit vector `axis`.
template <typename T>
Eigen::Matrix<T, 3, 3> RotationAbout(const Eigen::Matrix<T, 3, 1>& axis, const T& angle) {
  using std::cos;
  using std::sin;
  const T s = sin(angle);
  const T half_sine = sin(T(0.5) * angle);
  const Eigen::Matrix<T, 3, 3> k = CrossMatrix(axis);
  return Eigen::Matrix<T, 3, 3>::Identity() + s * k + T(2) * half_sine * half_sine * (k * k);
}

/// The angle [rad] of the rotation in (-pi, pi] about `axis` (unit length) that is closest to `r`: it
/// maximises tr(r^T R(axis, angle)) = (tr r - axis^T r axis) cos + (axis . vee(r - r^T)) sin + const.
inline double AngleAbout(const Eigen::Vector3d& axis, const Eigen::Matrix3d& r) {
  const Eigen::Vector3d vee(r(2, 1) - r(1, 2), r(0, 2) - r(2, 0), r(1, 0) - r(0, 1));
  return std::atan2(axis.dot(vee), r.trace() - axis.dot(r * axis));
}

/// The angle [rad] in [0, pi] between two rotations; exact at both ends.
inline double AngleBetween(const Eigen::Quaterniond& a, const Eigen::Quaterniond& b) {
  const Eigen::Quaterniond d = a.conjugate() * b;
  return 2 * std::atan2(d.vec().norm(), std::abs(d.w()));
}

/// `angle` [rad] less whole turns, in (-pi, pi].
inline double WrapAngle(double angle) {
  const double turn = 2 * kPi;
  const double wrapped = std::remainder(angle, turn);
  return wrapped <= -turn / 2 ? wrapped + turn : wrapped;
}

/// The rotation closest to a 3x3 matrix in the Frobenius norm.
inline Eigen::Matrix3d ClosestRotation(const Eigen::Matrix3d& m) {
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(m, Eigen::ComputeFullU | Eigen::ComputeFullV);
  const double sign = (svd.matrixU() * svd.matrixV().transpose()).determinant() < 0 ? -1 : 1;
  return svd.matrixU() * Eigen::Vector3d(1, 1, sign).asDiagonal() * svd.matrixV().transpose();
}

/// Geodesic L1 mean (Weiszfeld): stays put when a minority of the rotations is wrong. It starts from the
/// member with the least sum of angles to the others, so the cost grows with the square of their number.
inline Eigen::Quaterniond MedianRotation(const std::vector<Eigen::Quaterniond>& rotations) {
  Eigen::Quaterniond median = Eigen::Quaterniond::Identity();
  double best = std::numeric_limits<double>::infinity();
  for (const Eigen::Quaterniond& candidate : rotations) {
    double sum = 0;
    for (const Eigen::Quaterniond& other : rotations) sum += AngleBetween(candidate, other);
    if (sum < best) {
      best = sum;
      median = candidate;
    }
  }
  for (int iteration = 0; iteration < 50; ++iteration) {
    Eigen::Vector3d step = Eigen::Vector3d::Zero();
    double weight_sum = 0;
    for (const Eigen::Quaterniond& r : rotations) {
      const Eigen::Quaterniond d = r * median.conjugate();
      const Eigen::Vector3d w = LogQuaternion<double>(d.w(), d.x(), d.y(), d.z());
      const double weight = 1 / std::max(w.norm(), 1e-12);
      step += weight * w;
      weight_sum += weight;
    }
    if (weight_sum == 0) break;
    step /= weight_sum;
    median = (Eigen::Quaterniond(ExpRotation<double>(step)) * median).normalized();
    if (step.norm() < 1e-14) break;
  }
  return median;
}

}  // namespace s2gs
