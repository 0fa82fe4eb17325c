#pragma once

// kernel/intersect.h and kernel/composite.h for eight pixels at a time. backend_drawing_test.cc and
// tile_kernel_test.cc hold both to the same. Included by one source file per processor, which defines
// S2GS_TILE_NAMESPACE. Only built-in vectors and functions: an inline function of a library compiled here for
// AVX2 could be the copy that the linker keeps.

#include "s2gs/cpu/pack_impl.h"
#include "s2gs/cpu/tile_kernel.h"
#include "s2gs/kernel/constants.h"

// One file for each instruction set includes this in a namespace of its own.
// NOLINTBEGIN(misc-definitions-in-headers)

namespace s2gs {
namespace S2GS_TILE_NAMESPACE {
namespace {

// kernel/constants.h's, in float.
constexpr auto kMinAlphaF = static_cast<float>(kMinAlpha);
constexpr auto kMaxAlphaF = static_cast<float>(kMaxAlpha);
constexpr auto kMinTransmittanceF = static_cast<float>(kMinTransmittance);
constexpr auto kLowPass = static_cast<float>(kLowPassInverseVariance);

// Which packs of the tile a splat touches: rows [row0, row1), halves [half0, half1].
struct Range {
  int row0, row1, half0, half1;
};

S2GS_INLINE Range RangeOf(const SplatRow& s, int x0, int y0) {
  Range range;
  range.row0 = s.y_begin > y0 ? s.y_begin - y0 : 0;
  range.row1 = s.y_end < y0 + kTileSize ? s.y_end - y0 : kTileSize;
  range.half0 = s.x_begin >= x0 + kPackWidth ? 1 : 0;
  range.half1 = s.x_end > x0 + kPackWidth ? 1 : 0;
  return range;
}

// kernel/intersect.h's PixelHit for eight pixels.
struct Hit {
  Pack dx;
  float dy;
  Pack r2, falloff, alpha, a, b, inverse_q, depth;
  Ints on_disc, is_capped;
};

// HitSplat, without the test of alpha. False when no lane is near.
S2GS_INLINE bool HitPack(const SplatRow& s, Pack pixel_x, float pixel_y, float near_depth, Ints live,
                         Hit* hit) {
  hit->dx = pixel_x - s.x;
  hit->dy = pixel_y - s.y;
  const Pack low_pass = kLowPass * (hit->dx * hit->dx + Splat8(hit->dy * hit->dy));
  const Pack q = s.wx * hit->dx + Splat8(1 + s.wy * hit->dy);
  const Ints in_front = (q > 1e-6F) & (q * near_depth <= Splat8(s.depth));
  hit->inverse_q = 1.0F / Select(in_front, q, Splat8(1.0F));
  hit->a = (s.ux * hit->dx + Splat8(s.uy * hit->dy)) * hit->inverse_q;
  hit->b = (s.vx * hit->dx + Splat8(s.vy * hit->dy)) * hit->inverse_q;
  const Pack on_disc = hit->a * hit->a + hit->b * hit->b;
  hit->on_disc = in_front & (on_disc < low_pass);
  hit->r2 = Select(hit->on_disc, on_disc, low_pass);
  if (!Any(live & (hit->r2 <= s.cutoff2))) return false;
  hit->falloff = ExpOfNegative(-0.5F * hit->r2);
  const Pack alpha = s.opacity * hit->falloff;
  hit->is_capped = alpha > kMaxAlphaF;
  hit->alpha = Min(alpha, Splat8(kMaxAlphaF));
  hit->depth = Select(hit->on_disc, s.depth * hit->inverse_q, Splat8(s.depth));
  return true;
}

S2GS_INLINE Pack PixelColumns(int x0, int half) {
  const float first = static_cast<float>(x0 + half * kPackWidth) + 0.5F;
  return Splat8(first) + Pack{0, 1, 2, 3, 4, 5, 6, 7};
}

template <bool kGeometry, bool kForeground, bool kPeak>
void ForwardTile(const TileJob& job) {
  Pack transmittance[kTilePacks], color[3][kTilePacks];
  Pack foreground[kForeground ? kTilePacks : 1];
  constexpr int kGeometryPacks = kGeometry ? kTilePacks : 1;
  Pack normal[3][kGeometryPacks], depth[kGeometryPacks], median[kGeometryPacks], distortion[kGeometryPacks];
  Pack total[kGeometryPacks], m1[kGeometryPacks], m2[kGeometryPacks];
  Ints stop[kTilePacks];
  bool is_done[kTilePacks];
  const Ints never = Splat8(job.num_entries);
  const Pack zero = Splat8(0.0F);
  for (int i = 0; i < kTilePacks; ++i) {
    transmittance[i] = Splat8(1.0F);
    for (int c = 0; c < 3; ++c) color[c][i] = zero;
    stop[i] = never;
    is_done[i] = false;
    if (kForeground) foreground[i] = zero;
    if (kGeometry) {
      for (int c = 0; c < 3; ++c) normal[c][i] = zero;
      depth[i] = median[i] = distortion[i] = total[i] = m1[i] = m2[i] = zero;
    }
  }
  int num_done = 0;
  const Pack columns[2] = {PixelColumns(job.x0, 0), PixelColumns(job.x0, 1)};

  int32_t n = 0;
  for (; n < job.num_entries && num_done < kTilePacks; ++n) {
    const SplatRow& s = job.splats[job.entries[n].splat];
    const Range range = RangeOf(s, job.x0, job.y0);
    Pack peak = zero;
    for (int row = range.row0; row < range.row1; ++row) {
      const float pixel_y = static_cast<float>(job.y0 + row) + 0.5F;
      for (int half = range.half0; half <= range.half1; ++half) {
        const int i = 2 * row + half;
        if (is_done[i]) continue;
        const Ints live = stop[i] == never;
        Hit hit;
        if (!HitPack(s, columns[half], pixel_y, job.near_depth, live, &hit)) continue;
        const Ints is_hit = live & (hit.alpha >= kMinAlphaF);
        const Pack before = transmittance[i];
        const Pack left = before * (1.0F - hit.alpha);
        const Ints ends = is_hit & (left < kMinTransmittanceF);
        const Ints adds = is_hit & ~ends;
        if (Any(ends)) {
          stop[i] = (ends & Splat8(n)) | (~ends & stop[i]);
          if (!Any(stop[i] == never)) {
            is_done[i] = true;
            ++num_done;
          }
        }
        const Pack weight = Where(adds, hit.alpha * before);
        color[0][i] += weight * s.red;
        color[1][i] += weight * s.green;
        color[2][i] += weight * s.blue;
        if (kForeground) foreground[i] += weight * s.foreground;
        if (kGeometry) {
          const Pack m = -job.near_depth / hit.depth;
          distortion[i] += weight * (m * (m * total[i] - 2.0F * m1[i]) + m2[i]);
          total[i] += weight;
          m1[i] += weight * m;
          m2[i] += weight * m * m;
          depth[i] += weight * hit.depth;
          normal[0][i] += weight * s.nx;
          normal[1][i] += weight * s.ny;
          normal[2][i] += weight * s.nz;
          const Ints is_median = adds & (before > 0.5F) & (left <= 0.5F);
          median[i] = Select(is_median, hit.depth, median[i]);
        }
        transmittance[i] = Select(adds, left, before);
        if (kPeak) peak = Max(peak, weight);
      }
    }
    if (kPeak) job.peak_by_slot[job.entries[n].slot] = Largest(peak);
  }
  if (kPeak) {
    for (; n < job.num_entries; ++n) job.peak_by_slot[job.entries[n].slot] = 0;
  }

  const ViewPlanes& out = job.planes;
  for (int i = 0; i < kTilePacks; ++i) {
    const size_t at = (job.y0 + i / 2) * out.stride + job.x0 + i % 2 * kPackWidth;
    Store(out.transmittance + at, transmittance[i]);
    for (int c = 0; c < 3; ++c) Store(out.color[c] + at, color[c][i]);
    if (kForeground) Store(out.foreground + at, foreground[i]);
    if (kGeometry) {
      for (int c = 0; c < 3; ++c) Store(out.normal[c] + at, normal[c][i]);
      Store(out.weight + at, total[i]);
      Store(out.depth + at, depth[i]);
      Store(out.median + at, median[i]);
      Store(out.distortion + at, distortion[i]);
      Store(out.m1 + at, m1[i]);
      Store(out.m2 + at, m2[i]);
    }
    StoreInts(out.stop + at, stop[i]);
  }
}

template <bool kGeometry, bool kForeground>
void BackwardTile(const TileJob& job) {
  // kernel/composite.h's PixelAdjoint and PixelGradient.
  Pack transmittance[kTilePacks], behind[kTilePacks], d_color[3][kTilePacks];
  Pack d_foreground[kForeground ? kTilePacks : 1];
  constexpr int kGeometryPacks = kGeometry ? kTilePacks : 1;
  Pack d_normal[3][kGeometryPacks], d_depth[kGeometryPacks], d_distortion[kGeometryPacks];
  Pack depth[kGeometryPacks], inverse_total[kGeometryPacks], total[kGeometryPacks], m1[kGeometryPacks],
      m2[kGeometryPacks];
  Ints stop[kTilePacks];
  int32_t last[kTilePacks];  // the largest stop of the pack
  int32_t end = 0;
  const ViewPlanes& view = job.planes;
  for (int i = 0; i < kTilePacks; ++i) {
    const size_t at = (job.y0 + i / 2) * view.stride + job.x0 + i % 2 * kPackWidth;
    transmittance[i] = Load(view.transmittance + at);
    for (int c = 0; c < 3; ++c) d_color[c][i] = Load(job.gradients.color[c] + at);
    Pack towards_alpha = Splat8(0.0F);
    if (job.gradients.alpha != nullptr) towards_alpha = Load(job.gradients.alpha + at);
    behind[i] = transmittance[i] * (d_color[0][i] * job.background[0] + d_color[1][i] * job.background[1] +
                                    d_color[2][i] * job.background[2] - towards_alpha);
    if (kForeground) d_foreground[i] = Load(job.gradients.foreground + at);
    if (kGeometry) {
      for (int c = 0; c < 3; ++c) d_normal[c][i] = Load(job.gradients.normal[c] + at);
      d_depth[i] = Load(job.gradients.expected_depth + at);
      d_distortion[i] = Load(job.gradients.distortion + at);
      total[i] = Load(view.weight + at);
      const Ints is_filled = total[i] > 0.0F;
      inverse_total[i] = Where(is_filled, 1.0F / Select(is_filled, total[i], Splat8(1.0F)));
      depth[i] = Load(view.depth + at) * inverse_total[i];
      m1[i] = Load(view.m1 + at);
      m2[i] = Load(view.m2 + at);
    }
    stop[i] = LoadInts(view.stop + at);
    last[i] = 0;
    for (int lane = 0; lane < kPackWidth; ++lane) last[i] = stop[i][lane] > last[i] ? stop[i][lane] : last[i];
    end = last[i] > end ? last[i] : end;
  }
  const SplatGradient none = {};
  for (int32_t n = end; n < job.num_entries; ++n) job.by_slot[job.entries[n].slot] = none;
  const Pack columns[2] = {PixelColumns(job.x0, 0), PixelColumns(job.x0, 1)};
  const Pack zero = Splat8(0.0F);

  for (int32_t n = end - 1; n >= 0; --n) {
    const SplatRow& s = job.splats[job.entries[n].splat];
    const Range range = RangeOf(s, job.x0, job.y0);
    Pack gx = zero, gy = zero, gux = zero, guy = zero, gvx = zero, gvy = zero, gwx = zero, gwy = zero;
    Pack g_opacity = zero, g_red = zero, g_green = zero, g_blue = zero, g_foreground = zero, g_depth = zero;
    Pack g_nx = zero, g_ny = zero, g_nz = zero;
    for (int row = range.row0; row < range.row1; ++row) {
      const float pixel_y = static_cast<float>(job.y0 + row) + 0.5F;
      for (int half = range.half0; half <= range.half1; ++half) {
        const int i = 2 * row + half;
        if (n >= last[i]) continue;
        const Ints live = stop[i] > n;
        Hit hit;
        if (!HitPack(s, columns[half], pixel_y, job.near_depth, live, &hit)) continue;
        const Ints adds = live & (hit.alpha >= kMinAlphaF);
        // UndoHit.
        const Pack inverse_left = 1.0F / (1.0F - hit.alpha);
        transmittance[i] = Select(adds, transmittance[i] * inverse_left, transmittance[i]);
        const Pack weight = Where(adds, hit.alpha * transmittance[i]);
        Pack by_weight = d_color[0][i] * s.red + d_color[1][i] * s.green + d_color[2][i] * s.blue;
        g_red += weight * d_color[0][i];
        g_green += weight * d_color[1][i];
        g_blue += weight * d_color[2][i];
        if (kForeground) {
          by_weight += d_foreground[i] * s.foreground;
          g_foreground += weight * d_foreground[i];
        }
        Pack d_hit_depth = zero;
        if (kGeometry) {
          const Pack m = -job.near_depth / hit.depth;
          by_weight += d_normal[0][i] * s.nx + d_normal[1][i] * s.ny + d_normal[2][i] * s.nz +
                       d_depth[i] * (hit.depth - depth[i]) * inverse_total[i] +
                       d_distortion[i] * (m * (m * total[i] - 2.0F * m1[i]) + m2[i]);
          g_nx += weight * d_normal[0][i];
          g_ny += weight * d_normal[1][i];
          g_nz += weight * d_normal[2][i];
          d_hit_depth = weight * (d_depth[i] * inverse_total[i] -
                                  d_distortion[i] * 2.0F * (m * total[i] - m1[i]) * m / hit.depth);
        }
        const Pack d_alpha = transmittance[i] * by_weight - behind[i] * inverse_left;
        behind[i] += weight * by_weight;
        // HitSplatAdjoint.
        const Pack d_uncapped = Where(adds & ~hit.is_capped, d_alpha);
        g_opacity += d_uncapped * hit.falloff;
        const Pack d_r2 = -0.5F * d_uncapped * hit.alpha;
        const Pack low = Where(~hit.on_disc, (-2.0F * kLowPass) * d_r2);
        const Pack on_disc = Where(hit.on_disc, 2.0F * d_r2 * hit.inverse_q);
        const Pack d_a = on_disc * hit.a;
        const Pack d_b = on_disc * hit.b;
        Pack d_q = -(d_a * hit.a + d_b * hit.b);
        if (kGeometry) {
          const Pack through_disc = Where(hit.on_disc, d_hit_depth * hit.inverse_q);
          d_q -= through_disc * hit.depth;
          g_depth += Select(hit.on_disc, through_disc, d_hit_depth);
        }
        gx += low * hit.dx - (d_a * s.ux + d_b * s.vx + d_q * s.wx);
        gy += low * hit.dy - (d_a * s.uy + d_b * s.vy + d_q * s.wy);
        gux += d_a * hit.dx;
        guy += d_a * hit.dy;
        gvx += d_b * hit.dx;
        gvy += d_b * hit.dy;
        gwx += d_q * hit.dx;
        gwy += d_q * hit.dy;
      }
    }
    SplatGradient& g = job.by_slot[job.entries[n].slot];
    g.x = Sum(gx);
    g.y = Sum(gy);
    g.ux = Sum(gux);
    g.uy = Sum(guy);
    g.vx = Sum(gvx);
    g.vy = Sum(gvy);
    g.wx = Sum(gwx);
    g.wy = Sum(gwy);
    g.opacity = Sum(g_opacity);
    g.red = Sum(g_red);
    g.green = Sum(g_green);
    g.blue = Sum(g_blue);
    g.foreground = kForeground ? Sum(g_foreground) : 0;
    g.depth = kGeometry ? Sum(g_depth) : 0;
    g.nx = kGeometry ? Sum(g_nx) : 0;
    g.ny = kGeometry ? Sum(g_ny) : 0;
    g.nz = kGeometry ? Sum(g_nz) : 0;
  }
}

void Forward(const TileJob& job, bool geometry, bool foreground) {
  if (job.peak_by_slot != nullptr) {
    ForwardTile<false, false, true>(job);
  } else if (geometry) {
    foreground ? ForwardTile<true, true, false>(job) : ForwardTile<true, false, false>(job);
  } else {
    foreground ? ForwardTile<false, true, false>(job) : ForwardTile<false, false, false>(job);
  }
}

void Backward(const TileJob& job, bool geometry, bool foreground) {
  if (geometry) {
    foreground ? BackwardTile<true, true>(job) : BackwardTile<true, false>(job);
  } else {
    foreground ? BackwardTile<false, true>(job) : BackwardTile<false, false>(job);
  }
}

}  // namespace
}  // namespace S2GS_TILE_NAMESPACE
}  // namespace s2gs
// NOLINTEND(misc-definitions-in-headers)
