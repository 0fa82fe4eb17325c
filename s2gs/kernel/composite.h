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
template <bool kWithGeometry, bool kWithForeground, bool kWithDistortion = kWithGeometry>
struct Channels {
  static constexpr bool kGeometry = kWithGeometry;      ///< depth and normal.
  static constexpr bool kForeground = kWithForeground;  ///< map of p.
  static constexpr bool kDistortion = kWithDistortion;  ///< with geometry alone.
  static_assert(kWithGeometry || !kWithDistortion);
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
    if constexpr (C::kDistortion) {
      const T m = MappedDepth(hit.depth, near_depth);
      pixel->distortion += weight * (m * (m * pixel->weight - T(2) * pixel->m1) + pixel->m2);
      pixel->m1 += weight * m;
      pixel->m2 += weight * m * m;
    }
    pixel->weight += weight;
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

/// What the backward pass of one pixel needs to know of all its hits.
template <typename T>
struct PixelTotals {
  T by_depth_sum;    ///< the loss by sum of w z.
  T depth;           ///< the pixel's expected depth.
  T weight, m1, m2;  ///< as in Pixel.
};

/// State of the backward pass of one pixel, which goes from back to front.
template <typename T>
struct PixelAdjoint {
  T transmittance;  ///< in front of the hits already gone through; the final one at first.
  T behind;         ///< sum over the hits gone through of w_i dL/dw_i, and the background's share.
  PixelTotals<T> totals;
};

/// \param background  the colour behind everything.
template <typename C, typename T>
S2GS_HD inline PixelAdjoint<T> BeginPixelAdjoint(const Pixel<T>& pixel, const PixelGradient<T>& d,
                                                 const Vec3<T>& background) {
  PixelAdjoint<T> state;
  state.transmittance = pixel.transmittance;
  state.behind = pixel.transmittance * (Dot(d.color, background) - d.alpha);
  if constexpr (C::kGeometry) {
    const T inverse_weight = pixel.weight > T(0) ? T(1) / pixel.weight : T(0);
    state.totals.by_depth_sum = d.expected_depth * inverse_weight;
    state.totals.depth = pixel.depth * inverse_weight;
    state.totals.weight = pixel.weight;
    state.totals.m1 = pixel.m1;
    state.totals.m2 = pixel.m2;
  }
  return state;
}

/// dL/dw_i = g_i of a hit of weight w_i: each enters the loss by its own.
/// \param depth  the hit's.
template <typename C, typename T>
S2GS_HD inline T LossByWeight(const Splat<T>& s, T depth, const PixelGradient<T>& d,
                              const PixelTotals<T>& totals, T near_depth) {
  T by_weight = Dot(d.color, s.color);
  if constexpr (C::kForeground) by_weight += d.foreground * s.foreground;
  if constexpr (C::kGeometry) {
    by_weight += Dot(d.normal, s.footprint.normal) + totals.by_depth_sum * (depth - totals.depth);
    if constexpr (C::kDistortion) {
      const T m = MappedDepth(depth, near_depth);
      by_weight += d.distortion * (m * (m * totals.weight - T(2) * totals.m1) + totals.m2);
    }
  }
  return by_weight;
}

/// A hit's weight, and the loss by its alpha.
template <typename T>
struct HitAdjoint {
  T weight, d_alpha;
};

/// Undoes the next hit from the back. alpha_i scales w_i and damps all behind: dL/dalpha_i = T_i g_i -
/// sum_{j>i} w_j g_j / (1 - alpha_i).
template <typename T>
S2GS_HD inline HitAdjoint<T> UndoWeight(T alpha, T by_weight, PixelAdjoint<T>* state) {
  const T inverse_left = FastReciprocal(T(1) - alpha);
  state->transmittance = state->transmittance * inverse_left;
  const T weight = alpha * state->transmittance;
  const T d_alpha = state->transmittance * by_weight - state->behind * inverse_left;
  state->behind += weight * by_weight;
  return {weight, d_alpha};
}

/// Adds to the loss by a hit's splat.
template <typename C, typename T>
S2GS_HD inline void AddSplatAdjoint(const Splat<T>& s, const PixelHit<T>& hit, const HitAdjoint<T>& by_hit,
                                    const PixelGradient<T>& d, const PixelTotals<T>& totals, T near_depth,
                                    Splat<T>* d_splat) {
  T d_depth(0);
  d_splat->color += by_hit.weight * d.color;
  if constexpr (C::kForeground) d_splat->foreground += by_hit.weight * d.foreground;
  if constexpr (C::kGeometry) {
    d_splat->footprint.normal += by_hit.weight * d.normal;
    T by_depth = totals.by_depth_sum;
    if constexpr (C::kDistortion) {
      // dm/dz = near / z^2 = -m / z
      const T m = MappedDepth(hit.depth, near_depth);
      by_depth -= d.distortion * T(2) * (m * totals.weight - totals.m1) * m * FastReciprocal(hit.depth);
    }
    d_depth = by_hit.weight * by_depth;
  }
  HitSplatAdjoint(s.footprint, hit, by_hit.d_alpha, d_depth, &d_splat->footprint, &d_splat->opacity);
}

/// Undoes the next hit from the back and adds to the loss by its splat.
template <typename C, typename T>
S2GS_HD inline void UndoHit(const Splat<T>& s, const PixelHit<T>& hit, const PixelGradient<T>& d,
                            T near_depth, PixelAdjoint<T>* state, Splat<T>* d_splat) {
  const T by_weight = LossByWeight<C>(s, hit.depth, d, state->totals, near_depth);
  const HitAdjoint<T> by_hit = UndoWeight(hit.alpha, by_weight, state);
  AddSplatAdjoint<C>(s, hit, by_hit, d, state->totals, near_depth, d_splat);
}

}  // namespace s2gs
