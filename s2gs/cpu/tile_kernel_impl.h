// Included by one source file per processor, which defines S2GS_TILE_NAMESPACE. Only built-in vectors and
// functions: an inline function of a library compiled here for AVX2 could be the copy that the linker keeps.

#include "s2gs/cpu/tile_kernel.h"
#include "s2gs/kernel/constants.h"

// One file for each instruction set includes this in a namespace of its own.
// NOLINTBEGIN(misc-definitions-in-headers)

namespace s2gs {
namespace S2GS_TILE_NAMESPACE {
namespace {

#define S2GS_INLINE __attribute__((always_inline)) inline

// kernel/constants.h's, in float.
constexpr float kMinAlphaF = 1.0F / 255;
constexpr float kMaxAlphaF = 0.99F;
constexpr float kMinTransmittanceF = 1e-4F;
constexpr float kLowPass = static_cast<float>(kLowPassInverseVariance);

typedef float Pack __attribute__((vector_size(32)));
typedef int32_t Ints __attribute__((vector_size(32)));
typedef int64_t Longs __attribute__((vector_size(32)));

S2GS_INLINE Pack Splat8(float x) { return Pack{x, x, x, x, x, x, x, x}; }
S2GS_INLINE Ints Splat8(int32_t x) { return Ints{x, x, x, x, x, x, x, x}; }
S2GS_INLINE Pack Load(const float* p) {
  Pack v;
  __builtin_memcpy(&v, p, sizeof(v));
  return v;
}
S2GS_INLINE void Store(float* p, Pack v) { __builtin_memcpy(p, &v, sizeof(v)); }
S2GS_INLINE Ints LoadInts(const int32_t* p) {
  Ints v;
  __builtin_memcpy(&v, p, sizeof(v));
  return v;
}
S2GS_INLINE void StoreInts(int32_t* p, Ints v) { __builtin_memcpy(p, &v, sizeof(v)); }
// Lanes of the mask keep their value, the others become 0.
S2GS_INLINE Pack Where(Ints mask, Pack v) { return (Pack)(mask & (Ints)v); }
S2GS_INLINE Pack Select(Ints mask, Pack a, Pack b) { return (Pack)((mask & (Ints)a) | (~mask & (Ints)b)); }
S2GS_INLINE bool Any(Ints mask) {
  const Longs v = (Longs)mask;
  return ((v[0] | v[1]) | (v[2] | v[3])) != 0;
}
S2GS_INLINE Pack Min(Pack a, Pack b) { return Select(a < b, a, b); }
S2GS_INLINE Pack Max(Pack a, Pack b) { return Select(a > b, a, b); }
S2GS_INLINE float Sum(Pack v) { return ((v[0] + v[4]) + (v[2] + v[6])) + ((v[1] + v[5]) + (v[3] + v[7])); }
S2GS_INLINE float Largest(Pack v) {
  float largest = v[0];
  for (int i = 1; i < kPackWidth; ++i) largest = v[i] > largest ? v[i] : largest;
  return largest;
}

// e^x for x in [-80, 0] to 2 units in the last place: 2^n 2^f, f in [-1/2, 1/2] by its Taylor series.
S2GS_INLINE Pack ExpOfNegative(Pack x) {
  const Pack magic = Splat8(12582912.0F);  // 1.5 * 2^23: adding it rounds to whole numbers
  const Pack t = Max(x, Splat8(-80.0F)) * 1.44269504F;
  const Pack shifted = t + magic;
  const Pack n = shifted - magic;
  const Pack f = t - n;
  Pack p = Splat8(1.5403530e-4F);
  p = p * f + 1.3333558e-3F;
  p = p * f + 9.6181291e-3F;
  p = p * f + 5.5504109e-2F;
  p = p * f + 2.4022651e-1F;
  p = p * f + 6.9314718e-1F;
  p = p * f + 1.0F;
  const Ints power = ((Ints)shifted << 23) + Splat8(0x3F800000);
  return p * (Pack)power;
}

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

// --- L1 and SSIM: kernel/loss.h's
// ----------------------------------------------------------------------------
constexpr int kRadius = 5;
constexpr float kWindow[2 * kRadius + 1] = {
    0.00102838008447911F, 0.007598758135239185F, 0.03600077212843083F, 0.10936068950970002F,
    0.2130055377112537F,  0.26601172486179436F,  0.2130055377112537F,  0.10936068950970002F,
    0.03600077212843083F, 0.007598758135239185F, 0.00102838008447911F};

// Rows of these buffers begin 8 floats of zeros after `stride` multiples and end with 8 more (see PhotoLoss
// in gaussian_pass.h), so that windows and whole packs may reach over the border.
S2GS_INLINE Pack AcrossRow(const float* row, int x) {
  Pack sum = Splat8(0.0F);
  for (int k = 0; k <= 2 * kRadius; ++k) sum += kWindow[k] * Load(row + x + k - kRadius);
  return sum;
}

S2GS_INLINE Pack AcrossColumn(const float* plane, size_t stride, int height, int x, int y) {
  Pack sum = Splat8(0.0F);
  const int first = y < kRadius ? kRadius - y : 0;
  const int last = y + kRadius >= height ? height - 1 - y + kRadius : 2 * kRadius;
  for (int k = first; k <= last; ++k) sum += kWindow[k] * Load(plane + (y + k - kRadius) * stride + x);
  return sum;
}

S2GS_INLINE Ints InsideRow(int x, int width) {
  return Ints{0, 1, 2, 3, 4, 5, 6, 7} + Splat8(x) < Splat8(width);
}

void PhotoLossRow(const PhotoLossJob& job, int pass, int y) {
  const size_t row = y * job.stride;
  const float* rendered = job.rendered + row;
  const float* photo = job.photo + row;
  if (pass == 0) {
    for (int x = 0; x < job.width; x += kPackWidth) {
      Pack sums[5] = {};
      for (int k = 0; k <= 2 * kRadius; ++k) {
        const Pack a = Load(rendered + x + k - kRadius);
        const Pack b = Load(photo + x + k - kRadius);
        const Pack wa = kWindow[k] * a;
        const Pack wb = kWindow[k] * b;
        sums[0] += wa;
        sums[1] += wb;
        sums[2] += wa * a;
        sums[3] += wb * b;
        sums[4] += wa * b;
      }
      for (int j = 0; j < 5; ++j) Store(job.scratch[j] + row + x, sums[j]);
    }
    return;
  }
  if (pass == 1) {
    // The derivatives go to d_rendered's row for by_mean and, once read by nobody else, to the next pass.
    double total = 0;
    for (int x = 0; x < job.width; x += kPackWidth) {
      const Pack mx = AcrossColumn(job.scratch[0], job.stride, job.height, x, y);
      const Pack my = AcrossColumn(job.scratch[1], job.stride, job.height, x, y);
      const Pack xx = AcrossColumn(job.scratch[2], job.stride, job.height, x, y);
      const Pack yy = AcrossColumn(job.scratch[3], job.stride, job.height, x, y);
      const Pack xy = AcrossColumn(job.scratch[4], job.stride, job.height, x, y);
      // ComputeSsimPoint.
      const float c1 = 0.01F * 0.01F, c2 = 0.03F * 0.03F;
      const Pack a1 = 2.0F * mx * my + c1;
      const Pack a2 = 2.0F * (xy - mx * my) + c2;
      const Pack b1 = mx * mx + my * my + c1;
      const Pack b2 = (xx - mx * mx) + (yy - my * my) + c2;
      const Pack inverse = 1.0F / (b1 * b2);
      const Pack value = a1 * a2 * inverse;
      const Pack by_product = 2.0F * a1 * inverse;
      const Pack by_square = -value / b2;
      const Pack by_mean =
          2.0F * (my * a2 * inverse - mx * value / b1) - my * by_product - 2.0F * mx * by_square;
      const Ints inside = InsideRow(x, job.width);
      const Pack counted = Where(inside, value);
      for (int lane = 0; lane < kPackWidth; ++lane) total += counted[lane];
      Store(job.d_rendered + row + x, Where(inside, by_mean));
      Store(job.by_square + row + x, Where(inside, by_square));
      Store(job.by_product + row + x, Where(inside, by_product));
    }
    job.ssim_rows[y] = total;
    return;
  }
  if (pass == 2) {
    for (int x = 0; x < job.width; x += kPackWidth) {
      Store(job.scratch[0] + row + x, AcrossRow(job.d_rendered + row, x));
      Store(job.scratch[1] + row + x, AcrossRow(job.by_square + row, x));
      Store(job.scratch[2] + row + x, AcrossRow(job.by_product + row, x));
    }
    return;
  }
  double total = 0;
  for (int x = 0; x < job.width; x += kPackWidth) {
    const Pack by_mean = AcrossColumn(job.scratch[0], job.stride, job.height, x, y);
    const Pack by_square = AcrossColumn(job.scratch[1], job.stride, job.height, x, y);
    const Pack by_product = AcrossColumn(job.scratch[2], job.stride, job.height, x, y);
    const Pack a = Load(rendered + x);
    const Pack b = Load(photo + x);
    const Pack difference = a - b;
    const Ints inside = InsideRow(x, job.width);
    const Pack sign = Where(difference > 0.0F, Splat8(1.0F)) - Where(difference < 0.0F, Splat8(1.0F));
    const Pack d_ssim = by_mean + 2.0F * a * by_square + b * by_product;
    Store(job.d_rendered + row + x, Where(inside, job.l1_weight * sign + job.ssim_weight * d_ssim));
    const Pack size = Where(inside, Select(difference < 0.0F, -difference, difference));
    for (int lane = 0; lane < kPackWidth; ++lane) total += size[lane];
  }
  job.l1_rows[y] = total;
}

void PhotoLoss(const PhotoLossJob& job, int pass, int row_begin, int row_end) {
  for (int y = row_begin; y < row_end; ++y) PhotoLossRow(job, pass, y);
}

// --- Adam: kernel/adam.h's
// -----------------------------------------------------------------------------------
void Adam(float rate, float first_correction, float second_correction, const float* gradient, size_t count,
          float* parameter, float* first_moment, float* second_moment) {
  constexpr float kMaxGradient = 1e15F;
  const float scaled_rate = rate;
  for (size_t i = 0; i < count; i += kPackWidth) {
    // The last pack may be incomplete.
    const size_t left = count - i;
    Pack g, p, m, v;
    if (left >= kPackWidth) {
      g = Load(gradient + i);
      p = Load(parameter + i);
      m = Load(first_moment + i);
      v = Load(second_moment + i);
    } else {
      g = p = m = v = Splat8(0.0F);
      __builtin_memcpy(&g, gradient + i, left * sizeof(float));
      __builtin_memcpy(&p, parameter + i, left * sizeof(float));
      __builtin_memcpy(&m, first_moment + i, left * sizeof(float));
      __builtin_memcpy(&v, second_moment + i, left * sizeof(float));
    }
    g = Where(g == g, g);
    g = Max(Min(g, Splat8(kMaxGradient)), Splat8(-kMaxGradient));
    m = m + 0.1F * (g - m);
    v = v + 0.001F * (g * g - v);
    Pack root;
    for (int lane = 0; lane < kPackWidth; ++lane) root[lane] = __builtin_sqrtf(v[lane]);
    p -= scaled_rate * (m * first_correction) / (root * second_correction + 1e-15F);
    if (left >= kPackWidth) {
      Store(parameter + i, p);
      Store(first_moment + i, m);
      Store(second_moment + i, v);
    } else {
      __builtin_memcpy(parameter + i, &p, left * sizeof(float));
      __builtin_memcpy(first_moment + i, &m, left * sizeof(float));
      __builtin_memcpy(second_moment + i, &v, left * sizeof(float));
    }
  }
}

}  // namespace
}  // namespace S2GS_TILE_NAMESPACE
}  // namespace s2gs
// NOLINTEND(misc-definitions-in-headers)
