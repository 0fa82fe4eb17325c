#pragma once

#include "s2gs/core/gaussians.h"
#include "s2gs/core/vec.h"
#include "s2gs/kernel/constants.h"

namespace s2gs {

/// Real spherical harmonics, orthonormal over the sphere, in the order and with the signs of 3DGS files.
constexpr double kShBand0 = 0.28209479177387814;

/// Bands 1 to `degree` at a unit vector; entries of higher bands are not written.
template <typename T>
S2GS_HD inline void ShRestBasis(int degree, const Vec3<T>& d, T* basis) {
  if (degree < 1) return;
  const T x = d.x, y = d.y, z = d.z;
  const T c1(0.4886025119029199);
  basis[0] = -c1 * y;
  basis[1] = c1 * z;
  basis[2] = -c1 * x;
  if (degree < 2) return;
  const T xx = x * x, yy = y * y, zz = z * z;
  const T c2(1.0925484305920792), c2z(0.31539156525252005), c2x(0.5462742152960396);
  basis[3] = c2 * x * y;
  basis[4] = -c2 * y * z;
  basis[5] = c2z * (T(2) * zz - xx - yy);
  basis[6] = -c2 * x * z;
  basis[7] = c2x * (xx - yy);
  if (degree < 3) return;
  const T c30(0.5900435899266435), c31(2.890611442640554), c32(0.4570457994644658), c33(0.3731763325901154),
      c35(1.445305721320277);
  basis[8] = -c30 * y * (T(3) * xx - yy);
  basis[9] = c31 * x * y * z;
  basis[10] = -c32 * y * (T(4) * zz - xx - yy);
  basis[11] = c33 * z * (T(2) * zz - T(3) * (xx + yy));
  basis[12] = -c32 * x * (T(4) * zz - xx - yy);
  basis[13] = c35 * z * (xx - yy);
  basis[14] = -c30 * x * (xx - T(3) * yy);
}

/// Adjoint of ShRestBasis. \param d_basis  the loss by the basis. \return the loss by the vector's
/// components.
template <typename T>
S2GS_HD inline Vec3<T> ShRestBasisAdjoint(int degree, const Vec3<T>& d, const T* d_basis) {
  Vec3<T> g = {T(0), T(0), T(0)};
  if (degree < 1) return g;
  const T x = d.x, y = d.y, z = d.z;
  const T* b = d_basis;
  const T c1(0.4886025119029199);
  g = {-c1 * b[2], -c1 * b[0], c1 * b[1]};
  if (degree < 2) return g;
  const T two(2);
  const T c2(1.0925484305920792), c2z(0.31539156525252005), c2x(0.5462742152960396);
  g.x += c2 * (y * b[3] - z * b[6]) + two * x * (c2x * b[7] - c2z * b[5]);
  g.y += c2 * (x * b[3] - z * b[4]) - two * y * (c2x * b[7] + c2z * b[5]);
  g.z += -c2 * (y * b[4] + x * b[6]) + T(4) * c2z * z * b[5];
  if (degree < 3) return g;
  const T xx = x * x, yy = y * y, zz = z * z;
  const T c30(0.5900435899266435), c31(2.890611442640554), c32(0.4570457994644658), c33(0.3731763325901154),
      c35(1.445305721320277);
  const T three(3), six(6), eight(8);
  g.x += -c30 * six * x * y * b[8] + c31 * y * z * b[9] + c32 * two * x * y * b[10] -
         c33 * six * x * z * b[11] - c32 * (T(4) * zz - three * xx - yy) * b[12] + c35 * two * x * z * b[13] -
         c30 * three * (xx - yy) * b[14];
  g.y += -c30 * three * (xx - yy) * b[8] + c31 * x * z * b[9] - c32 * (T(4) * zz - xx - three * yy) * b[10] -
         c33 * six * y * z * b[11] + c32 * two * x * y * b[12] - c35 * two * y * z * b[13] +
         c30 * six * x * y * b[14];
  g.z += c31 * x * y * b[9] - c32 * eight * y * z * b[10] + c33 * three * (two * zz - xx - yy) * b[11] -
         c32 * eight * x * z * b[12] + c35 * (xx - yy) * b[13];
  return g;
}

constexpr int ShRestCount(int degree) { return (degree + 1) * (degree + 1) - 1; }

/// The colour's part that is the same from all sides.
template <typename T>
S2GS_HD inline Vec3<T> ShBaseColor(const Vec3<T>& dc) {
  const T half(0.5);
  return {half + T(kShBand0) * dc.x, half + T(kShBand0) * dc.y, half + T(kShBand0) * dc.z};
}

/// Colour of a Gaussian seen along a direction: .5 + sum of coefficients times basis, not below 0.
/// \param rest  rest(k, channel) is coefficient k of bands 1 to 3.
template <typename T, typename Rest>
S2GS_HD inline Vec3<T> ShColor(int degree, const Vec3<T>& dc, const Rest& rest, const Vec3<T>& direction) {
  T basis[kShRestPerChannel];
  ShRestBasis(degree, direction, basis);
  const T half(0.5);
  Vec3<T> color = {half + T(kShBand0) * dc.x, half + T(kShBand0) * dc.y, half + T(kShBand0) * dc.z};
  const int count = (degree + 1) * (degree + 1) - 1;
  for (int k = 0; k < count; ++k) color += basis[k] * Vec3<T>{rest(k, 0), rest(k, 1), rest(k, 2)};
  // Not a number stays what it is, for IsDrawableColor.
  return {color.x < T(0) ? T(0) : color.x, color.y < T(0) ? T(0) : color.y, color.z < T(0) ? T(0) : color.z};
}

/// Whether a colour that ShColor returned can be drawn; otherwise the splat is culled.
template <typename T>
S2GS_HD inline bool IsDrawableColor(const Vec3<T>& color) {
  return color.x < T(kMaxColor) && color.y < T(kMaxColor) && color.z < T(kMaxColor);
}

/// Adjoint of ShColor.
/// \param color     what ShColor returned: channels cut off at 0 pass nothing on.
/// \param d_color   the loss by the colour.
/// \param d_rest    d_rest(k, gradient) is called once per coefficient in use with its loss by R, G, B.
/// \param d_dc      out: the loss by band 0.
/// \return          the loss by the direction's components.
template <typename T, typename Rest, typename AddRest>
S2GS_HD inline Vec3<T> ShColorAdjoint(int degree, const Rest& rest, const Vec3<T>& direction,
                                      const Vec3<T>& color, const Vec3<T>& d_color, Vec3<T>* d_dc,
                                      const AddRest& d_rest) {
  const Vec3<T> d = {color.x > T(0) ? d_color.x : T(0), color.y > T(0) ? d_color.y : T(0),
                     color.z > T(0) ? d_color.z : T(0)};
  *d_dc = T(kShBand0) * d;
  T basis[kShRestPerChannel], d_basis[kShRestPerChannel];
  ShRestBasis(degree, direction, basis);
  const int count = (degree + 1) * (degree + 1) - 1;
  for (int k = 0; k < count; ++k) {
    d_basis[k] = d.x * rest(k, 0) + d.y * rest(k, 1) + d.z * rest(k, 2);
    d_rest(k, basis[k] * d);
  }
  return ShRestBasisAdjoint(degree, direction, d_basis);
}

}  // namespace s2gs
