#pragma once

#include <cmath>

#include "s2gs/core/host_device.h"

namespace s2gs {

/// Small vectors and matrices for the kernels: plain data, the same on the CPU and the GPU, of float, double
/// or ceres::Jet.
template <typename T>
struct Vec2 {
  T x, y;
};

template <typename T>
struct Vec3 {
  T x, y, z;
};

/// A quaternion w + xi + yj + zk, of any length.
template <typename T>
struct Quat {
  T w, x, y, z;
};

/// By columns.
template <typename T>
struct Mat3 {
  Vec3<T> x, y, z;
};

// --- Two components ----------------------------------------------------------------------------------------
template <typename T>
S2GS_HD inline Vec2<T> operator+(const Vec2<T>& a, const Vec2<T>& b) {
  return {a.x + b.x, a.y + b.y};
}
template <typename T>
S2GS_HD inline Vec2<T> operator*(const T& s, const Vec2<T>& a) {
  return {s * a.x, s * a.y};
}
template <typename T>
S2GS_HD inline void operator+=(Vec2<T>& a, const Vec2<T>& b) {
  a.x += b.x;
  a.y += b.y;
}
template <typename T>
S2GS_HD inline T Dot(const Vec2<T>& a, const Vec2<T>& b) {
  return a.x * b.x + a.y * b.y;
}

// --- Three components --------------------------------------------------------------------------------------
template <typename T>
S2GS_HD inline Vec3<T> operator+(const Vec3<T>& a, const Vec3<T>& b) {
  return {a.x + b.x, a.y + b.y, a.z + b.z};
}
template <typename T>
S2GS_HD inline Vec3<T> operator-(const Vec3<T>& a, const Vec3<T>& b) {
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}
template <typename T>
S2GS_HD inline Vec3<T> operator-(const Vec3<T>& a) {
  return {-a.x, -a.y, -a.z};
}
template <typename T>
S2GS_HD inline Vec3<T> operator*(const T& s, const Vec3<T>& a) {
  return {s * a.x, s * a.y, s * a.z};
}
template <typename T>
S2GS_HD inline void operator+=(Vec3<T>& a, const Vec3<T>& b) {
  a.x += b.x;
  a.y += b.y;
  a.z += b.z;
}
template <typename T>
S2GS_HD inline T Dot(const Vec3<T>& a, const Vec3<T>& b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}
template <typename T>
S2GS_HD inline Vec3<T> Cross(const Vec3<T>& a, const Vec3<T>& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
template <typename T>
S2GS_HD inline T Norm(const Vec3<T>& a) {
  using std::sqrt;
  return sqrt(Dot(a, a));
}

// --- Matrices ----------------------------------------------------------------------------------------------
template <typename T>
S2GS_HD inline Vec3<T> operator*(const Mat3<T>& m, const Vec3<T>& a) {
  return a.x * m.x + a.y * m.y + a.z * m.z;
}
/// The transposed matrix times a vector.
template <typename T>
S2GS_HD inline Vec3<T> TransposedTimes(const Mat3<T>& m, const Vec3<T>& a) {
  return {Dot(m.x, a), Dot(m.y, a), Dot(m.z, a)};
}

// --- Rotations ---------------------------------------------------------------------------------------------
/// The rotation of the quaternion q / |q|. \param inverse_length  1 / |q|.
template <typename T>
S2GS_HD inline Mat3<T> RotationMatrix(const Quat<T>& q, const T& inverse_length) {
  const T w = q.w * inverse_length, x = q.x * inverse_length, y = q.y * inverse_length,
          z = q.z * inverse_length;
  const T one(1), two(2);
  return {{one - two * (y * y + z * z), two * (x * y + w * z), two * (x * z - w * y)},
          {two * (x * y - w * z), one - two * (x * x + z * z), two * (y * z + w * x)},
          {two * (x * z + w * y), two * (y * z - w * x), one - two * (x * x + y * y)}};
}

/// Adjoint of RotationMatrix by q, through the normalisation. \param d_m  the loss by the matrix's elements.
template <typename T>
S2GS_HD inline Quat<T> RotationMatrixAdjoint(const Quat<T>& q, const T& inverse_length, const Mat3<T>& d_m) {
  const T w = q.w * inverse_length, x = q.x * inverse_length, y = q.y * inverse_length,
          z = q.z * inverse_length;
  const T two(2), four(4);
  // By the normalised quaternion.
  const T dw = two * (z * (d_m.x.y - d_m.y.x) + y * (d_m.z.x - d_m.x.z) + x * (d_m.y.z - d_m.z.y));
  const T dx = two * (y * (d_m.x.y + d_m.y.x) + z * (d_m.x.z + d_m.z.x) + w * (d_m.y.z - d_m.z.y)) -
               four * x * (d_m.y.y + d_m.z.z);
  const T dy = two * (x * (d_m.x.y + d_m.y.x) + w * (d_m.z.x - d_m.x.z) + z * (d_m.y.z + d_m.z.y)) -
               four * y * (d_m.x.x + d_m.z.z);
  const T dz = two * (w * (d_m.x.y - d_m.y.x) + x * (d_m.x.z + d_m.z.x) + y * (d_m.y.z + d_m.z.y)) -
               four * z * (d_m.x.x + d_m.y.y);
  // The length does not matter, so the gradient has no part along q.
  const T along = dw * w + dx * x + dy * y + dz * z;
  return {inverse_length * (dw - along * w), inverse_length * (dx - along * x),
          inverse_length * (dy - along * y), inverse_length * (dz - along * z)};
}

}  // namespace s2gs
