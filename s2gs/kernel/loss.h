#pragma once

#include <cmath>

#include "s2gs/core/vec.h"

namespace s2gs {

// --- L1 and D-SSIM -----------------------------------------------------------------------------------------
/// SSIM of Wang et al. as 3DGS and 2DGS use it: a window of 11 x 11, sigma 1.5, zeros outside the image,
/// variances of the population, colours in [0, 1].
constexpr int kSsimWindow = 11;
constexpr int kSsimRadius = kSsimWindow / 2;

/// What keeps SSIM's quotients finite, (.01 L)^2 and (.03 L)^2 of Wang et al. with L = 1.
constexpr double kSsimC1 = 0.01 * 0.01;
constexpr double kSsimC2 = 0.03 * 0.03;

/// The window along one axis; element i has offset i - 5. Sums to 1.
template <typename T>
S2GS_HD constexpr T SsimWeight(int i) {
  constexpr double kWeights[kSsimRadius + 1] = {0.00102838008447911, 0.007598758135239185,
                                                0.03600077212843083, 0.10936068950970002,
                                                0.2130055377112537,  0.26601172486179436};
  return T(kWeights[i <= kSsimRadius ? i : kSsimWindow - 1 - i]);
}

/// SSIM of one pixel and channel, and its derivatives by the windowed moments of the rendered image.
template <typename T>
struct SsimPoint {
  T value;
  T by_mean;     ///< by E[x], the variance and covariance varying with it.
  T by_square;   ///< by E[x^2]
  T by_product;  ///< by E[x y]
};

/// \param x, y        E[x] of the rendered and E[y] of the real image.
/// \param xx, yy, xy  E[x^2], E[y^2], E[x y].
template <typename T>
S2GS_HD inline SsimPoint<T> ComputeSsimPoint(T x, T y, T xx, T yy, T xy) {
  const T c1(kSsimC1), c2(kSsimC2), two(2);
  // value = (a1 a2) / (b1 b2)
  const T a1 = two * x * y + c1;
  const T a2 = two * (xy - x * y) + c2;
  const T b1 = x * x + y * y + c1;
  const T b2 = (xx - x * x) + (yy - y * y) + c2;
  const T inverse = T(1) / (b1 * b2);
  SsimPoint<T> s;
  s.value = a1 * a2 * inverse;
  s.by_product = two * a1 * inverse;
  s.by_square = -s.value / b2;
  // The moments depend on E[x] by a1, b1 directly and by the (co)variances.
  s.by_mean = two * (y * a2 * inverse - x * s.value / b1) - y * s.by_product - two * x * s.by_square;
  return s;
}

/// The loss of the mean SSIM by a pixel, from the windowed (the window is its own adjoint) derivatives.
template <typename T>
S2GS_HD inline T SsimAdjoint(T windowed_by_mean, T windowed_by_square, T windowed_by_product, T x, T y) {
  return windowed_by_mean + T(2) * x * windowed_by_square + y * windowed_by_product;
}

/// d|x - y| / dx
template <typename T>
S2GS_HD inline T L1Adjoint(T x, T y) {
  return x > y ? T(1) : x < y ? T(-1) : T(0);
}

// --- Normal consistency ------------------------------------------------------------------------------------
/// 2DGS's (14), sum of w_i (1 - n_i . N) = alpha - (rendered normal) . N, with N the normal of the depth map.
/// Both factors are differentiated, so the term never asks for more opacity.
/// N comes from central differences of the expected depth over the four neighbours, which must all be filled.
template <typename T>
struct DepthStencil {
  T left, right, up, down;  ///< expected depth of the neighbours; 0 where empty.
};

/// The point of a pixel at a depth, and how it is spread over its axes: X = depth * ray.
template <typename T>
S2GS_HD inline Vec3<T> PixelRay(T pixel_x, T pixel_y, T fx, T fy, T cx, T cy) {
  return {(pixel_x - cx) / fx, (pixel_y - cy) / fy, T(1)};
}

/// Normal of the depth map at a pixel, camera frame, facing the camera. False where there is none.
/// \param pixel_x, pixel_y  of the pixel's centre.
/// \param length            out: of the unnormalised normal.
template <typename T>
S2GS_HD inline bool NormalFromDepth(const DepthStencil<T>& z, T pixel_x, T pixel_y, T fx, T fy, T cx, T cy,
                                    Vec3<T>* normal, T* length) {
  if (!(z.left > T(0)) || !(z.right > T(0)) || !(z.up > T(0)) || !(z.down > T(0))) return false;
  const Vec3<T> along_x = z.right * PixelRay(pixel_x + T(1), pixel_y, fx, fy, cx, cy) -
                          z.left * PixelRay(pixel_x - T(1), pixel_y, fx, fy, cx, cy);
  const Vec3<T> along_y = z.down * PixelRay(pixel_x, pixel_y + T(1), fx, fy, cx, cy) -
                          z.up * PixelRay(pixel_x, pixel_y - T(1), fx, fy, cx, cy);
  // x right, y down: y cross x looks back at the camera.
  const Vec3<T> n = Cross(along_y, along_x);
  *length = Norm(n);
  if (!(*length > T(1e-30))) return false;
  *normal = (T(1) / *length) * n;
  return true;
}

/// Adjoint of NormalFromDepth where it is true: the loss by the four depths.
template <typename T>
S2GS_HD inline DepthStencil<T> NormalFromDepthAdjoint(const DepthStencil<T>& z, T pixel_x, T pixel_y, T fx,
                                                      T fy, T cx, T cy, const Vec3<T>& normal, T length,
                                                      const Vec3<T>& d_normal) {
  const Vec3<T> ray_right = PixelRay(pixel_x + T(1), pixel_y, fx, fy, cx, cy);
  const Vec3<T> ray_left = PixelRay(pixel_x - T(1), pixel_y, fx, fy, cx, cy);
  const Vec3<T> ray_down = PixelRay(pixel_x, pixel_y + T(1), fx, fy, cx, cy);
  const Vec3<T> ray_up = PixelRay(pixel_x, pixel_y - T(1), fx, fy, cx, cy);
  const Vec3<T> along_x = z.right * ray_right - z.left * ray_left;
  const Vec3<T> along_y = z.down * ray_down - z.up * ray_up;
  const Vec3<T> d_n = (T(1) / length) * (d_normal - Dot(d_normal, normal) * normal);
  const Vec3<T> d_y = Cross(along_x, d_n);
  const Vec3<T> d_x = Cross(d_n, along_y);
  return {-Dot(d_x, ray_left), Dot(d_x, ray_right), -Dot(d_y, ray_up), Dot(d_y, ray_down)};
}

}  // namespace s2gs
