#pragma once

#include <cmath>
#include <cstdint>

#include "s2gs/core/fast_math.h"
#include "s2gs/core/vec.h"
#include "s2gs/kernel/constants.h"
#include "s2gs/kernel/surfel.h"

namespace s2gs {

/// What a pixel needs to intersect its ray with a surfel. With d = pixel - centre [px], the ray meets the
/// surfel's plane at
///   q = 1 + w . d,   (a, b) = (u . d, v . d) / q  [standard deviations],   z = depth / q.
/// This is the inverse of 2DGS's homography from splat to screen, taken about the projected centre: no large
/// numbers cancel, and its terms are cross products of the axes with the centre.
template <typename T>
struct Footprint {
  Vec2<T> centre;  ///< projection of the splat's centre [px].
  Vec2<T> u, v, w;
  T depth;         ///< z of the centre.
  Vec3<T> normal;  ///< camera frame, facing the camera.
};

/// A rectangle of pixels, [begin, end).
struct PixelRect {
  int x_begin, y_begin, x_end, y_end;
};

/// The terms shared by the footprint and its adjoint.
template <typename T>
struct FootprintTerms {
  Vec3<T> normal;  ///< axis_u x axis_v
  T n_dot_c;
  T slope;  ///< z / (n . c)
  Vec3<T> v_x_c, c_x_u;
  T inverse_u, inverse_v;  ///< 1 / s
  bool has_disc;           ///< false: edge-on or of no size, the low-pass dot alone.
};

template <typename T>
S2GS_HD inline FootprintTerms<T> ComputeFootprintTerms(const Surfel<T>& s) {
  using std::abs;
  using std::exp;
  using std::sqrt;
  FootprintTerms<T> t;
  t.normal = Cross(s.axis_u, s.axis_v);
  t.n_dot_c = Dot(t.normal, s.centre);
  t.has_disc = abs(t.n_dot_c) > T(kMinCosine) * sqrt(Dot(s.centre, s.centre));
  t.slope = t.has_disc ? s.centre.z / t.n_dot_c : T(0);
  t.v_x_c = Cross(s.axis_v, s.centre);
  t.c_x_u = Cross(s.centre, s.axis_u);
  t.inverse_u = exp(-s.log_scale.x);
  t.inverse_v = exp(-s.log_scale.y);
  return t;
}

/// False when the splat is not drawn: it projects far outside, or something overflowed.
template <typename T>
S2GS_HD inline bool ComputeFootprint(const Surfel<T>& s, const SplatCamera<T>& camera,
                                     Footprint<T>* footprint) {
  using std::abs;
  FootprintTerms<T> t = ComputeFootprintTerms(s);
  const T inverse_z = T(1) / s.centre.z;
  footprint->centre = {camera.fx * s.centre.x * inverse_z + camera.cx,
                       camera.fy * s.centre.y * inverse_z + camera.cy};
  footprint->depth = s.centre.z;
  footprint->normal = t.n_dot_c > T(0) ? -t.normal : t.normal;
  const T by_fx = t.slope / camera.fx, by_fy = t.slope / camera.fy;
  footprint->u = {by_fx * t.inverse_u * t.v_x_c.x, by_fy * t.inverse_u * t.v_x_c.y};
  footprint->v = {by_fx * t.inverse_v * t.c_x_u.x, by_fy * t.inverse_v * t.c_x_u.y};
  footprint->w = {by_fx * t.normal.x, by_fy * t.normal.y};
  const T limit(kMaxInverseRadius);
  if (!t.has_disc || !(abs(footprint->u.x) < limit) || !(abs(footprint->u.y) < limit) ||
      !(abs(footprint->v.x) < limit) || !(abs(footprint->v.y) < limit)) {
    footprint->u = {limit, T(0)};
    footprint->v = {T(0), limit};
    footprint->w = {T(0), T(0)};
  }
  return abs(footprint->centre.x) < T(kMaxPixel) && abs(footprint->centre.y) < T(kMaxPixel);
}

/// Adjoint of ComputeFootprint: adds the loss by the surfel's centre, axes and log-scales to `d_surfel`.
/// \param d  the loss by the footprint's fields.
template <typename T>
S2GS_HD inline void ComputeFootprintAdjoint(const Surfel<T>& s, const SplatCamera<T>& camera,
                                            const Footprint<T>& footprint, const Footprint<T>& d,
                                            Surfel<T>* d_surfel) {
  const FootprintTerms<T> t = ComputeFootprintTerms(s);
  const T inverse_z = T(1) / s.centre.z;
  Vec3<T> d_c = {d.centre.x * camera.fx * inverse_z, d.centre.y * camera.fy * inverse_z, d.depth};
  d_c.z -= (d_c.x * s.centre.x + d_c.y * s.centre.y) * inverse_z;
  Vec3<T> d_n = t.n_dot_c > T(0) ? -d.normal : d.normal;

  const T limit(kMaxInverseRadius);
  const bool is_dot = footprint.u.x == limit && footprint.v.y == limit;
  if (!is_dot) {
    const T inverse_fx = T(1) / camera.fx, inverse_fy = T(1) / camera.fy;
    const Vec2<T> du = {d.u.x * inverse_fx, d.u.y * inverse_fy};
    const Vec2<T> dv = {d.v.x * inverse_fx, d.v.y * inverse_fy};
    const Vec2<T> dw = {d.w.x * inverse_fx, d.w.y * inverse_fy};
    // u = slope / s_u * (axis_v x c).xy / f, and so on: the scale first, it divides u as a whole.
    d_surfel->log_scale.x -= Dot(d.u, footprint.u);
    d_surfel->log_scale.y -= Dot(d.v, footprint.v);
    const T d_slope = t.inverse_u * (du.x * t.v_x_c.x + du.y * t.v_x_c.y) +
                      t.inverse_v * (dv.x * t.c_x_u.x + dv.y * t.c_x_u.y) + dw.x * t.normal.x +
                      dw.y * t.normal.y;
    const T scale_u = t.slope * t.inverse_u, scale_v = t.slope * t.inverse_v;
    const Vec3<T> d_v_x_c = {scale_u * du.x, scale_u * du.y, T(0)};
    const Vec3<T> d_c_x_u = {scale_v * dv.x, scale_v * dv.y, T(0)};
    d_surfel->axis_v += Cross(s.centre, d_v_x_c);
    d_c += Cross(d_v_x_c, s.axis_v);
    d_surfel->axis_u += Cross(d_c_x_u, s.centre);
    d_c += Cross(s.axis_u, d_c_x_u);
    d_n += Vec3<T>{t.slope * dw.x, t.slope * dw.y, T(0)};
    // slope = z / (n . c)
    const T by_n_dot_c = d_slope / t.n_dot_c;
    d_c.z += by_n_dot_c;
    d_n += (-by_n_dot_c * t.slope) * s.centre;
    d_c += (-by_n_dot_c * t.slope) * t.normal;
  }
  // n = axis_u x axis_v
  d_surfel->axis_u += Cross(s.axis_v, d_n);
  d_surfel->axis_v += Cross(d_n, s.axis_u);
  d_surfel->centre += d_c;
}

// --- A pixel -----------------------------------------------------------------------------------------------
/// Where a pixel's ray meets a splat.
template <typename T>
struct PixelHit {
  T alpha;         ///< 0: not hit.
  T depth;         ///< z of the hit; on the low-pass branch that of the splat's centre.
  T falloff;       ///< exp(-r^2 / 2)
  T a, b;          ///< disc branch: coordinates on the splat [standard deviations].
  T inverse_q;     ///< disc branch.
  Vec2<T> offset;  ///< pixel - centre [px].
  bool is_low_pass;
  bool is_capped;  ///< alpha was cut to its maximum: no derivative.
};

/// Squared distance r^2 from the splat's centre in standard deviations: the smaller of that on the disc and
/// that of the low-pass filter on the screen (2DGS, equation 11). Fills all of `hit` but alpha and falloff.
template <typename T>
S2GS_HD inline T SquaredRadius(const Footprint<T>& s, T pixel_x, T pixel_y, T near_depth, PixelHit<T>* hit) {
  hit->offset = {pixel_x - s.centre.x, pixel_y - s.centre.y};
  const T low_pass = T(kLowPassInverseVariance) * Dot(hit->offset, hit->offset);
  const T q = T(1) + Dot(s.w, hit->offset);
  hit->is_low_pass = true;
  hit->depth = s.depth;
  // z = depth / q must lie in front of the camera, beyond the near plane, and not on the horizon.
  if (q > T(1e-6) && q * near_depth <= s.depth) {
    const T inverse_q = FastReciprocal(q);
    const T a = Dot(s.u, hit->offset) * inverse_q;
    const T b = Dot(s.v, hit->offset) * inverse_q;
    const T on_disc = a * a + b * b;
    if (on_disc < low_pass) {
      hit->is_low_pass = false;
      hit->a = a;
      hit->b = b;
      hit->inverse_q = inverse_q;
      hit->depth = s.depth * inverse_q;
      return on_disc;
    }
  }
  return low_pass;
}

/// False when the pixel's ray does not hit the splat: alpha below 1/255.
/// \param pixel_x, pixel_y  the pixel's centre, COLMAP's convention.
template <typename T>
S2GS_HD inline bool HitSplat(const Footprint<T>& s, T opacity, T pixel_x, T pixel_y, T near_depth,
                             PixelHit<T>* hit) {
  const T r2 = SquaredRadius(s, pixel_x, pixel_y, near_depth, hit);
  hit->falloff = FastExp(T(-0.5) * r2);
  hit->alpha = opacity * hit->falloff;
  hit->is_capped = hit->alpha > T(kMaxAlpha);
  if (hit->is_capped) hit->alpha = T(kMaxAlpha);
  return hit->alpha >= T(kMinAlpha);
}

/// Adjoint of HitSplat: adds to the loss by the footprint and by the opacity.
/// \param d_alpha, d_depth  the loss by the hit's alpha and depth.
template <typename T>
S2GS_HD inline void HitSplatAdjoint(const Footprint<T>& s, const PixelHit<T>& hit, T d_alpha, T d_depth,
                                    Footprint<T>* d_footprint, T* d_opacity) {
  const T d_uncapped = hit.is_capped ? T(0) : d_alpha;
  *d_opacity += d_uncapped * hit.falloff;
  const T d_r2 = T(-0.5) * d_uncapped * hit.alpha;
  if (hit.is_low_pass) {
    d_footprint->depth += d_depth;
    d_footprint->centre += (T(-2 * kLowPassInverseVariance) * d_r2) * hit.offset;
    return;
  }
  // r^2 = a^2 + b^2 with a = u.d / q, b = v.d / q; z = depth / q.
  const T d_a = T(2) * d_r2 * hit.a * hit.inverse_q;
  const T d_b = T(2) * d_r2 * hit.b * hit.inverse_q;
  const T d_q = -(d_a * hit.a + d_b * hit.b + d_depth * hit.depth * hit.inverse_q);
  d_footprint->depth += d_depth * hit.inverse_q;
  d_footprint->u += d_a * hit.offset;
  d_footprint->v += d_b * hit.offset;
  d_footprint->w += d_q * hit.offset;
  d_footprint->centre +=
      Vec2<T>{-(d_a * s.u.x + d_b * s.v.x + d_q * s.w.x), -(d_a * s.u.y + d_b * s.v.y + d_q * s.w.y)};
}

// --- Bounds ------------------------------------------------------------------------------------------------
/// r^2 at which alpha falls below 1/255; not positive when the splat is invisible everywhere.
template <typename T>
S2GS_HD inline T CutoffSquaredRadius(T opacity) {
  using std::log;
  return T(2) * log(opacity * T(1 / kMinAlpha));
}

/// Widens [lower, upper] to the projections, along one image axis, of the part of an ellipse beyond the near
/// plane. The ellipse is c + a cos t + b sin t; here with that axis' coordinate x and the depth z.
template <typename T>
S2GS_HD inline void ExtendByEllipse(T cx, T ax, T bx, T cz, T az, T bz, T near_depth, T* lower, T* upper) {
  using std::sqrt;
  const auto add = [&](T cos_t, T sin_t, bool on_near_plane) {
    T z = cz + az * cos_t + bz * sin_t;
    if (on_near_plane) z = near_depth;
    if (!(z >= near_depth)) return;
    const T projected = (cx + ax * cos_t + bx * sin_t) / z;
    if (projected < *lower) *lower = projected;
    if (projected > *upper) *upper = projected;
  };
  // x / z is stationary where p cos t + q sin t + r = 0.
  const T p = bx * cz - cx * bz, q = cx * az - ax * cz, r = bx * az - ax * bz;
  const T pq2 = p * p + q * q;
  const T root2 = pq2 - r * r;
  if (pq2 > T(0) && root2 >= T(0)) {
    const T root = sqrt(root2) / pq2, along = -r / pq2;
    add(along * p - root * q, along * q + root * p, false);
    add(along * p + root * q, along * q - root * p, false);
  }
  // Where the ellipse passes through the near plane, the chord's ends.
  const T h = cz - near_depth;
  const T ab2 = az * az + bz * bz;
  const T chord2 = ab2 - h * h;
  if (ab2 > T(0) && chord2 >= T(0)) {
    const T root = sqrt(chord2) / ab2, along = -h / ab2;
    add(along * az - root * bz, along * bz + root * az, true);
    add(along * az + root * bz, along * bz - root * az, true);
  }
}

/// The pixels whose centres a splat can hit: exact for its opacity, and right where the disc passes through
/// the camera's plane. False when there are none.
template <typename T>
S2GS_HD inline bool BoundSplat(const Surfel<T>& s, const Footprint<T>& footprint,
                               const SplatCamera<T>& camera, PixelRect* rect) {
  using std::exp;
  using std::sqrt;
  const T cutoff2 = CutoffSquaredRadius(s.opacity);
  if (!(cutoff2 > T(0))) return false;
  const T cutoff = sqrt(cutoff2);
  const T filter = cutoff * T(kLowPassSigma);
  T x_lower = footprint.centre.x - filter, x_upper = footprint.centre.x + filter;
  T y_lower = footprint.centre.y - filter, y_upper = footprint.centre.y + filter;
  if (footprint.u.x != T(kMaxInverseRadius)) {
    // A disc of a million times the distance fills its half of the image already.
    const T longest = T(1e6) * sqrt(Dot(s.centre, s.centre));
    T radius_u = cutoff * exp(s.log_scale.x), radius_v = cutoff * exp(s.log_scale.y);
    if (!(radius_u < longest)) radius_u = longest;
    if (!(radius_v < longest)) radius_v = longest;
    // In units of the depth, so that squares neither overflow nor vanish.
    const T inverse_z = T(1) / s.centre.z;
    const Vec3<T> c = inverse_z * s.centre;
    const Vec3<T> a = (radius_u * inverse_z) * s.axis_u, b = (radius_v * inverse_z) * s.axis_v;
    const T near_depth = camera.near_depth * inverse_z;
    T lower = c.x, upper = c.x;
    ExtendByEllipse(c.x, a.x, b.x, T(1), a.z, b.z, near_depth, &lower, &upper);
    lower = lower * camera.fx + camera.cx;
    upper = upper * camera.fx + camera.cx;
    if (lower < x_lower) x_lower = lower;
    if (upper > x_upper) x_upper = upper;
    lower = upper = c.y;
    ExtendByEllipse(c.y, a.y, b.y, T(1), a.z, b.z, near_depth, &lower, &upper);
    lower = lower * camera.fy + camera.cy;
    upper = upper * camera.fy + camera.cy;
    if (lower < y_lower) y_lower = lower;
    if (upper > y_upper) y_upper = upper;
  }
  // Rounding of the bounds themselves; a pixel's centre lies half a pixel into it.
  constexpr double kMargin = 0.02;
  const auto begin = [](T lower, int size) {
    const T pixel = lower - T(0.5 + kMargin);
    if (!(pixel > T(0))) return 0;
    if (!(pixel < T(size))) return size;
    const int floor = static_cast<int>(pixel);
    return T(floor) < pixel ? floor + 1 : floor;
  };
  const auto end = [](T upper, int size) {
    const T pixel = upper + T(0.5 + kMargin);
    if (!(pixel > T(0))) return 0;
    return pixel < T(size) ? static_cast<int>(pixel) : size;
  };
  *rect = {begin(x_lower, camera.width), begin(y_lower, camera.height), end(x_upper, camera.width),
           end(y_upper, camera.height)};
  return rect->x_begin < rect->x_end && rect->y_begin < rect->y_end;
}

/// Pixels of a rectangle of 8 x 4 that a splat may hit: bit 8 y + x is that of the pixel whose centre is
/// (x0 + x, y0 + y). In each row they are those between two bounds, which hold what the disc and its low-pass
/// dot reach, widened by what rounding may move them by; rows that a disc's horizon crosses count as a whole.
/// \param cutoff2  CutoffSquaredRadius(opacity).
template <typename T>
S2GS_HD inline uint32_t PixelsMayHit(const Footprint<T>& s, T cutoff2, T x0, T y0) {
  using std::abs;
  using std::ceil;
  using std::floor;
  using std::sqrt;
  constexpr double kSlack = 1e-3;   // of r^2
  constexpr double kMargin = 0.01;  // [px]
  const auto smaller = [](T a, T b) { return a < b ? a : b; };
  const auto larger = [](T a, T b) { return a > b ? a : b; };
  const T bound = cutoff2 + T(kSlack) * (T(1) + cutoff2);
  const T dot2 = bound * T(kLowPassSigma * kLowPassSigma);
  // With d = (x, y) from the centre and a = (u.x, v.x, w.x), b = (u.y y, v.y y, 1 + w.y y), the disc is where
  // <a x + b, a x + b> <= 0 by <p, q> = p1 q1 + p2 q2 - bound p3 q3: m x^2 + 2 n x + k <= 0.
  const T m = s.u.x * s.u.x + s.v.x * s.v.x - bound * s.w.x * s.w.x;
  const T inverse_m = T(1) / m;
  // What is left of m has five digits then.
  const bool is_bounded = m > T(0.01) * (bound * s.w.x * s.w.x);
  const T nowhere(1e30);
  const T left = x0 - s.centre.x;
  uint32_t pixels = 0;
  for (int row = 0; row < 4; ++row) {
    const T y = y0 + T(row) - s.centre.y;
    const T dot_half2 = dot2 - y * y;
    const T dot_half = dot_half2 >= T(0) ? sqrt(dot_half2) : -nowhere;
    const T b1 = s.u.y * y, b2 = s.v.y * y, b3 = T(1) + s.w.y * y;
    // n^2 - m k = bound (e2^2 + e3^2) - e1^2 by the components of a x b: no large numbers cancel but in e1.
    const T p = s.u.x * b2, q = s.v.x * b1;
    const T e1 = larger(abs(p - q) - T(4 * 1.2e-7) * (abs(p) + abs(q)), T(0));
    const T e2 = s.u.x * b3 - s.w.x * b1, e3 = s.v.x * b3 - s.w.x * b2;
    const T root2 = bound * (e2 * e2 + e3 * e3) - e1 * e1;
    const T middle = -(s.u.x * b1 + s.v.x * b2 - bound * s.w.x * b3) * inverse_m;
    T half = sqrt(larger(root2, T(0))) * inverse_m;
    half += T(4e-5) * (abs(middle) + half);
    if (!(root2 >= T(0))) half = -nowhere;
    T lower = smaller(-dot_half, middle - half) - left - T(kMargin);
    T upper = larger(dot_half, middle + half) - left + T(kMargin);
    if (!is_bounded) {
      lower = T(0);
      upper = T(7);
    }
    const auto begin = static_cast<int>(ceil(smaller(larger(lower, T(0)), T(8))));
    const auto end = static_cast<int>(floor(smaller(larger(upper, T(-1)), T(7)))) + 1;
    pixels |= ((0xFFU << begin) & ((1U << end) - 1)) << (8 * row);
  }
  return pixels;
}

/// Whether a splat reaches alpha 1/255 anywhere in a rectangle of pixel centres [x0, x1] x [y0, y1]: exact up
/// to rounding, except that rectangles crossed by a disc's horizon count as reached.
/// {|(u.d, v.d)| <= cutoff (1 + w.d)} is convex and holds the splat's centre: a rectangle that does not hold
/// the centre is reached if and only if one of its edges is.
template <typename T>
S2GS_HD inline bool ReachesRect(const Footprint<T>& s, T cutoff2, T x0, T y0, T x1, T y1) {
  const T left = x0 - s.centre.x, right = x1 - s.centre.x, top = y0 - s.centre.y, bottom = y1 - s.centre.y;
  const T x_near = left > T(0) ? left : right < T(0) ? right : T(0);
  const T y_near = top > T(0) ? top : bottom < T(0) ? bottom : T(0);
  if (T(kLowPassInverseVariance) * (x_near * x_near + y_near * y_near) <= cutoff2) return true;
  // f(d) = (u.d)^2 + (v.d)^2 - cutoff^2 (1 + w.d)^2 = xx d_x^2 + 2 xy d_x d_y + yy d_y^2 - 2 c w.d - c
  const T xx = s.u.x * s.u.x + s.v.x * s.v.x - cutoff2 * s.w.x * s.w.x;
  const T xy = s.u.x * s.u.y + s.v.x * s.v.y - cutoff2 * s.w.x * s.w.y;
  const T yy = s.u.y * s.u.y + s.v.y * s.v.y - cutoff2 * s.w.y * s.w.y;
  const T slack = T(1e-3) * cutoff2;
  // Along one edge: m t^2 + 2 n t + k <= 0 for a t in [t0, t1]?
  const auto reaches_edge = [&](T m, T n, T k, T t0, T t1) {
    if (!(m > T(0))) return true;
    T t = -n / m;
    t = t < t0 ? t0 : t > t1 ? t1 : t;
    return (m * t + T(2) * n) * t + k <= slack;
  };
  if (x_near != T(0)) {
    const T n = xy * x_near - cutoff2 * s.w.y;
    const T k = (xx * x_near - T(2) * cutoff2 * s.w.x) * x_near - cutoff2;
    if (reaches_edge(yy, n, k, top, bottom)) return true;
  }
  if (y_near != T(0)) {
    const T n = xy * y_near - cutoff2 * s.w.x;
    const T k = (yy * y_near - T(2) * cutoff2 * s.w.y) * y_near - cutoff2;
    if (reaches_edge(xx, n, k, left, right)) return true;
  }
  return false;
}

}  // namespace s2gs
