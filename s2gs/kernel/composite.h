#pragma once

#include "s2gs/core/fast_math.h"
#include "s2gs/core/vec.h"
#include "s2gs/kernel/constants.h"
#include "s2gs/kernel/intersect.h"

namespace s2gs {

/// One splat of one view, ready for compositing.
template <typename T>
struct Splat {
  Footprint<T> footprint;
  T opacity;
  Vec3<T> color;
  T foreground;  ///< p
};

/// Which maps are wanted. Compile-time, so that what is off costs nothing.
template <bool kWithGeometry, bool kWithForeground>
struct Channels {
  static constexpr bool kGeometry = kWithGeometry;      ///< depth, normal, distortion.
  static constexpr bool kForeground = kWithForeground;  ///< map of p.
};

/// One pixel while splats are composited into it from front to back (3). All sums have weights
/// w_i = alpha_i prod_{j<i} (1 - alpha_j).
template <typename T>
struct Pixel {
  T transmittance;
  Vec3<T> color;
  T foreground;
  Vec3<T> normal;
  T weight;        ///< sum of w: 1 - transmittance, without its rounding where little is drawn.
  T depth;         ///< sum of w z.
  T median_depth;  ///< z where the transmittance falls through 1/2; 0 until then.
  T distortion;    ///< sum over pairs of w_i w_j (m_i - m_j)^2, as in 2DGS.
  T m1, m2;        ///< sums of w m and w m^2.
};

template <typename T>
S2GS_HD inline Pixel<T> EmptyPixel() {
  const T zero(0);
  return {T(1), {zero, zero, zero}, zero, {zero, zero, zero}, zero, zero, zero, zero, zero, zero};
}

/// 2DGS maps depths to [0, 1] by 1 - near / z before it measures their spread. Only differences of m count,
/// so the 1 is left out: it would round the rest away.
template <typename T>
S2GS_HD inline T MappedDepth(const T& depth, const T& near_depth) {
  return -near_depth * FastReciprocal(depth);
}

/// Adds one hit. False, and nothing added, when the transmittance would fall below its minimum: the pixel is
/// done.
template <typename C, typename T>
S2GS_HD inline bool AddHit(const Splat<T>& s, const PixelHit<T>& hit, T near_depth, Pixel<T>* pixel) {
  const T left = pixel->transmittance * (T(1) - hit.alpha);
  if (left < T(kMinTransmittance)) return false;
  const T weight = hit.alpha * pixel->transmittance;
  pixel->color += weight * s.color;
  if constexpr (C::kForeground) pixel->foreground += weight * s.foreground;
  if constexpr (C::kGeometry) {
    const T m = MappedDepth(hit.depth, near_depth);
    pixel->distortion += weight * (m * (m * pixel->weight - T(2) * pixel->m1) + pixel->m2);
    pixel->weight += weight;
    pixel->m1 += weight * m;
    pixel->m2 += weight * m * m;
    pixel->depth += weight * hit.depth;
    pixel->normal += weight * s.footprint.normal;
    if (pixel->transmittance > T(0.5) && left <= T(0.5)) pixel->median_depth = hit.depth;
  }
  pixel->transmittance = left;
  return true;
}

/// sum of w z over sum of w; 0 for an empty pixel.
template <typename T>
S2GS_HD inline T ExpectedDepth(const Pixel<T>& pixel) {
  return pixel.weight > T(0) ? pixel.depth / pixel.weight : T(0);
}

/// The loss by one pixel's maps.
template <typename T>
struct PixelGradient {
  Vec3<T> color;  ///< by the colour with the background composited behind.
  T alpha;        ///< by 1 - transmittance, beyond what goes through the background colour.
  T foreground;
  Vec3<T> normal;
  T expected_depth;
  T distortion;
};

/// State of the backward pass of one pixel, which goes from back to front.
template <typename T>
struct PixelAdjoint {
  T transmittance;   ///< in front of the hits already gone through; the final one at first.
  T behind;          ///< sum over the hits gone through of w_i dL/dw_i, and the background's share.
  T inverse_weight;  ///< of the whole pixel.
  T depth;           ///< the pixel's expected depth.
  T weight, m1, m2;  ///< totals of the whole pixel.
};

/// \param background  the colour behind everything.
template <typename C, typename T>
S2GS_HD inline PixelAdjoint<T> BeginPixelAdjoint(const Pixel<T>& pixel, const PixelGradient<T>& d,
                                                 const Vec3<T>& background) {
  PixelAdjoint<T> state;
  state.transmittance = pixel.transmittance;
  state.behind = pixel.transmittance * (Dot(d.color, background) - d.alpha);
  if constexpr (C::kGeometry) {
    state.weight = pixel.weight;
    state.inverse_weight = state.weight > T(0) ? T(1) / state.weight : T(0);
    state.depth = pixel.depth * state.inverse_weight;
    state.m1 = pixel.m1;
    state.m2 = pixel.m2;
  }
  return state;
}

/// Undoes the next hit from the back and adds to the loss by its splat. Every w_i enters the loss by its own
/// dL/dw_i = g_i; alpha_i scales w_i and damps all behind: dL/dalpha_i = T_i g_i - sum_{j>i} w_j g_j / (1 -
/// alpha_i).
template <typename C, typename T>
S2GS_HD inline void UndoHit(const Splat<T>& s, const PixelHit<T>& hit, const PixelGradient<T>& d,
                            T near_depth, PixelAdjoint<T>* state, Splat<T>* d_splat) {
  const T inverse_left = FastReciprocal(T(1) - hit.alpha);
  state->transmittance = state->transmittance * inverse_left;
  const T weight = hit.alpha * state->transmittance;
  T by_weight = Dot(d.color, s.color);
  T d_depth(0);
  d_splat->color += weight * d.color;
  if constexpr (C::kForeground) {
    by_weight += d.foreground * s.foreground;
    d_splat->foreground += weight * d.foreground;
  }
  if constexpr (C::kGeometry) {
    const T m = MappedDepth(hit.depth, near_depth);
    by_weight += Dot(d.normal, s.footprint.normal) +
                 d.expected_depth * (hit.depth - state->depth) * state->inverse_weight +
                 d.distortion * (m * (m * state->weight - T(2) * state->m1) + state->m2);
    d_splat->footprint.normal += weight * d.normal;
    // dm/dz = near / z^2 = -m / z
    d_depth =
        weight * (d.expected_depth * state->inverse_weight -
                  d.distortion * T(2) * (m * state->weight - state->m1) * m * FastReciprocal(hit.depth));
  }
  const T d_alpha = state->transmittance * by_weight - state->behind * inverse_left;
  state->behind += weight * by_weight;
  HitSplatAdjoint(s.footprint, hit, d_alpha, d_depth, &d_splat->footprint, &d_splat->opacity);
}

}  // namespace s2gs
