#include "s2gs/cpu/regularise.h"

#include <algorithm>

#include "s2gs/core/vec.h"
#include "s2gs/kernel/foreground.h"
#include "s2gs/kernel/loss.h"

namespace s2gs {
namespace {

// Sums are taken over chunks of this many, then over chunks in order, whatever the number of threads.
constexpr int64_t kChunk = 1024;

double SumUp(const std::vector<double>& parts) {
  double sum = 0;
  for (const double part : parts) sum += part;
  return sum;
}

// What KlOfLogits and its adjoint need of each logit, once.
struct Likelihood {
  float p, q;      // sigmoid(logit), sigmoid(-logit)
  float softplus;  // ln(1 + e^logit)
};

}  // namespace

ForegroundTerms RegulariseForeground(const std::vector<float>& foreground_logit,
                                     const std::vector<uint32_t>& neighbours, int k,
                                     const LossWeights& weights, ThreadPool* threads,
                                     std::vector<float>* d_logit) {
  const auto count = static_cast<int64_t>(foreground_logit.size());
  d_logit->assign(foreground_logit.size(), 0.0F);
  ForegroundTerms terms;
  if (count == 0) return terms;
  const int64_t num_chunks = (count + kChunk - 1) / kChunk;
  std::vector<double> parts(num_chunks, 0);
  if (weights.entropy_3d > 0) {
    const float weight = weights.entropy_3d / static_cast<float>(count);
    threads->For(count, kChunk, [&](int64_t begin, int64_t end) {
      double sum = 0;
      for (int64_t i = begin; i < end; ++i) {
        sum += EntropyOfLogit(foreground_logit[i]);
        (*d_logit)[i] += weight * EntropyOfLogitAdjoint(foreground_logit[i]);
      }
      parts[begin / kChunk] = sum;
    });
    terms.entropy_3d = SumUp(parts) / static_cast<double>(count);
  }
  if (!(weights.local_consistency > 0) || k < 1 || neighbours.size() != static_cast<size_t>(count) * k)
    return terms;

  const double num_edges = static_cast<double>(count) * k;
  const auto weight = static_cast<float>(weights.local_consistency / num_edges);
  std::vector<Likelihood> likelihood(count);
  std::vector<float> to_neighbour(neighbours.size());
  threads->For(count, kChunk, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) {
      const float logit = foreground_logit[i];
      likelihood[i] = {Sigmoid(logit), Sigmoid(-logit), (logit > 0 ? logit : 0) + Log1pExpOfMinus(logit)};
    }
  });
  threads->For(count, kChunk, [&](int64_t begin, int64_t end) {
    double sum = 0;
    for (int64_t i = begin; i < end; ++i) {
      const float a = foreground_logit[i];
      const Likelihood& own = likelihood[i];
      float own_gradient = 0;
      for (int j = 0; j < k; ++j) {
        const uint32_t other = neighbours[i * k + j];
        const float b = foreground_logit[other];
        const Likelihood& its = likelihood[other];
        // KlOfLogits: by symmetry of both bodies, from the side where nothing large cancels.
        const float kl = a > 0 ? own.q * (b - a) + (its.softplus - b) - (own.softplus - a)
                               : own.p * (a - b) + its.softplus - own.softplus;
        sum += std::max(kl, 0.0F);
        own_gradient += own.p * own.q * (a - b);
        to_neighbour[i * k + j] = a > 0 && b > 0 ? own.q - its.q : its.p - own.p;
      }
      (*d_logit)[i] += weight * own_gradient;
    }
    parts[begin / kChunk] = sum;
  });
  // A Gaussian may be the neighbour of many: in one order.
  for (size_t edge = 0; edge < neighbours.size(); ++edge) {
    (*d_logit)[neighbours[edge]] += weight * to_neighbour[edge];
  }
  terms.local_consistency = SumUp(parts) / num_edges;
  return terms;
}

namespace {

// Expected depth at a pixel, 0 where it is empty or outside.
float DepthAt(const ViewMaps& maps, int x, int y) {
  if (x < 0 || y < 0 || x >= maps.view->width || y >= maps.view->height) return 0;
  const size_t at = y * maps.stride + x;
  const float weight = maps.weight[at];
  return weight > 0 ? maps.depth[at] / weight : 0;
}

// The normals' term of one row. The loss by the depths of the row above and below goes to `d_up`, `d_down`.
double NormalRow(const ViewMaps& maps, int y, float weight, float* d_depth, float* d_up, float* d_down) {
  const PinholeView& view = *maps.view;
  const auto fx = static_cast<float>(view.fx);
  const auto fy = static_cast<float>(view.fy);
  const auto cx = static_cast<float>(view.cx);
  const auto cy = static_cast<float>(view.cy);
  double sum = 0;
  for (int x = 0; x < view.width; ++x) {
    const size_t at = y * maps.stride + x;
    const DepthStencil<float> z = {DepthAt(maps, x - 1, y), DepthAt(maps, x + 1, y), DepthAt(maps, x, y - 1),
                                   DepthAt(maps, x, y + 1)};
    const float pixel_x = static_cast<float>(x) + 0.5F;
    const float pixel_y = static_cast<float>(y) + 0.5F;
    Vec3<float> normal{};
    float length = 0;
    if (!NormalFromDepth(z, pixel_x, pixel_y, fx, fy, cx, cy, &normal, &length)) continue;
    const Vec3<float> rendered = {maps.normal[0][at], maps.normal[1][at], maps.normal[2][at]};
    const float alpha = 1 - maps.transmittance[at];
    sum += alpha - Dot(rendered, normal);
    maps.d_alpha[at] += weight;
    maps.d_normal[0][at] -= weight * normal.x;
    maps.d_normal[1][at] -= weight * normal.y;
    maps.d_normal[2][at] -= weight * normal.z;
    const DepthStencil<float> d =
        NormalFromDepthAdjoint(z, pixel_x, pixel_y, fx, fy, cx, cy, normal, length, (-weight) * rendered);
    d_depth[x - 1] += d.left;
    d_depth[x + 1] += d.right;
    d_up[x] += d.up;
    d_down[x] += d.down;
  }
  return sum;
}

}  // namespace

ViewLossTerms RegulariseView(const ViewMaps& maps, const LossWeights& weights, ThreadPool* threads) {
  const int width = maps.view->width;
  const int height = maps.view->height;
  const double num_pixels = static_cast<double>(width) * height;
  const auto per_pixel = static_cast<float>(1 / num_pixels);
  for (float* plane : {maps.d_alpha, maps.d_foreground, maps.d_normal[0], maps.d_normal[1], maps.d_normal[2],
                       maps.d_expected_depth, maps.d_distortion}) {
    if (plane != nullptr) std::fill(plane, plane + maps.stride * height, 0.0F);
  }
  ViewLossTerms terms;
  std::vector<double> rows(height, 0);
  const auto for_rows = [&](const auto& body) {
    threads->For(height, [&](int64_t begin, int64_t end) {
      for (int64_t y = begin; y < end; ++y) body(static_cast<int>(y));
    });
  };
  if (maps.foreground != nullptr && (weights.entropy_2d > 0 || (weights.mask > 0 && maps.mask != nullptr))) {
    std::vector<double> mask_rows(height, 0);
    const float entropy_weight = weights.entropy_2d * per_pixel;
    const float mask_weight = maps.mask != nullptr ? weights.mask * per_pixel : 0;
    for_rows([&](int y) {
      for (int x = 0; x < width; ++x) {
        const size_t at = y * maps.stride + x;
        const float p = maps.foreground[at];
        if (entropy_weight > 0) {
          rows[y] += EntropyOfProbability(p);
          maps.d_foreground[at] += entropy_weight * EntropyOfProbabilityAdjoint(p);
        }
        if (mask_weight > 0) {
          const bool inside = maps.mask[static_cast<size_t>(y) * width + x] > 127;
          mask_rows[y] += MaskCrossEntropy(p, inside);
          maps.d_foreground[at] += mask_weight * MaskCrossEntropyAdjoint(p, inside);
        }
      }
    });
    terms.entropy_2d = SumUp(rows) / num_pixels;
    terms.mask = SumUp(mask_rows) / num_pixels;
  }
  if (weights.distortion > 0) {
    const float weight = weights.distortion * per_pixel;
    for (int y = 0; y < height; ++y) {
      double sum = 0;
      for (int x = 0; x < width; ++x) {
        sum += maps.distortion[y * maps.stride + x];
        maps.d_distortion[y * maps.stride + x] = weight;
      }
      rows[y] = sum;
    }
    terms.distortion = SumUp(rows) / num_pixels;
  }
  if (weights.normal > 0) {
    const float weight = weights.normal * per_pixel;
    // The loss by depths of three rows meets in one: each row's shares apart, then summed in order. A value
    // before and after each row takes what falls outside (always 0).
    const auto row_floats = static_cast<size_t>(width) + 2;
    std::vector<float> shares(3 * row_floats * height, 0.0F);
    const auto share = [&](int y, int which) {
      return shares.data() + (3 * static_cast<size_t>(y) + which) * row_floats + 1;
    };
    for_rows([&](int y) { rows[y] = NormalRow(maps, y, weight, share(y, 1), share(y, 0), share(y, 2)); });
    for_rows([&](int y) {
      float* out = maps.d_expected_depth + y * maps.stride;
      for (int x = 0; x < width; ++x) {
        float sum = share(y, 1)[x];
        if (y > 0) sum += share(y - 1, 2)[x];
        if (y + 1 < height) sum += share(y + 1, 0)[x];
        out[x] = sum;
      }
    });
    terms.normal = SumUp(rows) / num_pixels;
  }
  return terms;
}

}  // namespace s2gs
