#pragma once

// kernel/loss.h's L1 and SSIM and kernel/adam.h for eight values at a time. Of these headers constants alone
// are taken; backend_step_test.cc and tile_kernel_test.cc hold both to the same. Included by one source file
// per processor, which defines S2GS_TILE_NAMESPACE. Only built-in vectors and functions: an inline function
// of a library compiled here for AVX2 could be the copy that the linker keeps.

#include "s2gs/cpu/pack_impl.h"
#include "s2gs/cpu/tile_kernel.h"
#include "s2gs/kernel/adam.h"
#include "s2gs/kernel/loss.h"

// One file for each instruction set includes this in a namespace of its own.
// NOLINTBEGIN(misc-definitions-in-headers)

namespace s2gs {
namespace S2GS_TILE_NAMESPACE {
namespace {

constexpr int kRadius = kSsimRadius;
constexpr float kWindow[kSsimWindow] = {SsimWeight<float>(0), SsimWeight<float>(1), SsimWeight<float>(2),
                                        SsimWeight<float>(3), SsimWeight<float>(4), SsimWeight<float>(5),
                                        SsimWeight<float>(6), SsimWeight<float>(7), SsimWeight<float>(8),
                                        SsimWeight<float>(9), SsimWeight<float>(10)};

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
      constexpr auto c1 = static_cast<float>(kSsimC1), c2 = static_cast<float>(kSsimC2);
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

// --- Adam ---
void Adam(float rate, float first_correction, float second_correction, const float* gradient, size_t count,
          float* parameter, float* first_moment, float* second_moment) {
  constexpr auto kMaxGradient = static_cast<float>(kMaxAdamGradient);
  constexpr auto kNewShare = static_cast<float>(1 - kAdamBeta1);
  constexpr auto kNewSquare = static_cast<float>(1 - kAdamBeta2);
  constexpr auto kEpsilon = static_cast<float>(kAdamEpsilon);
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
    m = m + kNewShare * (g - m);
    v = v + kNewSquare * (g * g - v);
    Pack root;
    for (int lane = 0; lane < kPackWidth; ++lane) root[lane] = __builtin_sqrtf(v[lane]);
    p -= scaled_rate * (m * first_correction) / (root * second_correction + kEpsilon);
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
