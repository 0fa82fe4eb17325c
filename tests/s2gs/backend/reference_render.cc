#include "tests/s2gs/backend/reference_render.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numeric>

#include "s2gs/kernel/sh.h"
#include "sfm_split/base/angles.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

double SigmoidOf(double x) { return 1 / (1 + std::exp(-x)); }

struct ReferenceSplat {
  Vector3d centre, axis_u, axis_v, normal;
  double scale_u = 0, scale_v = 0, opacity = 0, foreground = 0;
  Vector3d color = Vector3d::Zero();
};

struct ReferenceRule {
  bool soft;
  SceneBodies bodies;
};

bool IsObject(const ReferenceGaussian& g, const ReferenceRule& rule) {
  if (rule.bodies == SceneBodies::kObjectOnly) return true;
  if (rule.bodies == SceneBodies::kStaticOnly) return false;
  return SigmoidOf(g[kRefForeground]) >= 0.8;
}

// False when the splat is not drawn.
bool MakeSplat(const ReferenceGaussian& g, const PinholeView& view, const ReferenceRule& rule, int sh_degree,
               ReferenceSplat* splat) {
  for (const double value : g) {
    if (!std::isfinite(value) || std::abs(value) > 1e30) return false;
  }
  const Vector3d x(g[0], g[1], g[2]);
  Eigen::Quaterniond q(g[kRefRotation], g[kRefRotation + 1], g[kRefRotation + 2], g[kRefRotation + 3]);
  if (q.norm() < 1e-15) return false;
  q.normalize();
  const bool is_object = IsObject(g, rule);
  const double p = rule.soft ? SigmoidOf(g[kRefForeground]) : is_object ? 1.0 : 0.0;
  splat->centre = p * (view.cam_from_object * x) + (1 - p) * (view.cam_from_world * x);
  if (!(splat->centre.z() >= view.near_depth)) return false;
  const Matrix3d body =
      (is_object ? view.cam_from_object.rotation : view.cam_from_world.rotation).toRotationMatrix();
  const Matrix3d axes = body * q.toRotationMatrix();
  splat->axis_u = axes.col(0);
  splat->axis_v = axes.col(1);
  splat->normal = axes.col(2);
  splat->scale_u = std::exp(g[kRefLogScale]);
  splat->scale_v = std::exp(g[kRefLogScale + 1]);
  splat->opacity = SigmoidOf(g[kRefOpacity]);
  splat->foreground = p;
  const Vector3d direction = body.transpose() * splat->centre.normalized();
  std::array<double, kShRestPerChannel> basis{};
  ShRestBasis(3, Vec3<double>{direction.x(), direction.y(), direction.z()}, basis.data());
  for (int c = 0; c < 3; ++c) {
    double value = 0.5 + 0.28209479177387814 * g[kRefDc + c];
    for (int k = 0; k < (sh_degree + 1) * (sh_degree + 1) - 1; ++k)
      value += basis[k] * g[kRefRest + 3 * k + c];
    splat->color[c] = std::max(0.0, value);
  }
  return true;
}

// alpha and depth where a pixel's ray meets a splat.
void Meet(const ReferenceSplat& s, const PinholeView& view, double px, double py, double* alpha,
          double* depth) {
  const double screen_x = view.fx * s.centre.x() / s.centre.z() + view.cx;
  const double screen_y = view.fy * s.centre.y() / s.centre.z() + view.cy;
  double r2 = ((px - screen_x) * (px - screen_x) + (py - screen_y) * (py - screen_y)) / (0.3 * 0.3);
  *depth = s.centre.z();
  const Vector3d ray((px - view.cx) / view.fx, (py - view.cy) / view.fy, 1);
  const double facing = s.normal.dot(s.centre);
  if (std::abs(facing) > 1e-3 * s.centre.norm()) {
    const double along = facing / s.normal.dot(ray);
    const Vector3d hit = along * ray;
    if (along > 0 && hit.z() >= view.near_depth) {
      const double a = s.axis_u.dot(hit - s.centre) / s.scale_u, b = s.axis_v.dot(hit - s.centre) / s.scale_v;
      if (a * a + b * b < r2) {
        r2 = a * a + b * b;
        *depth = hit.z();
      }
    }
  }
  *alpha = std::min(0.99, s.opacity * std::exp(-r2 / 2));
}

double Ssim(const std::vector<double>& a, const std::vector<double>& b, int width, int height) {
  std::array<double, 11> window{};
  for (int i = 0; i < 11; ++i) window[i] = std::exp(-(i - 5) * (i - 5) / (2 * 1.5 * 1.5));
  const double norm = std::accumulate(window.begin(), window.end(), 0.0);
  double sum = 0;
  for (int c = 0; c < 3; ++c) {
    for (int y = 0; y < height; ++y) {
      for (int x = 0; x < width; ++x) {
        double ma = 0, mb = 0, aa = 0, bb = 0, ab = 0;
        for (int v = std::max(0, y - 5); v <= std::min(height - 1, y + 5); ++v) {
          for (int u = std::max(0, x - 5); u <= std::min(width - 1, x + 5); ++u) {
            const double w = window[u - x + 5] * window[v - y + 5] / (norm * norm);
            const double va = a[3 * (v * width + u) + c], vb = b[3 * (v * width + u) + c];
            ma += w * va;
            mb += w * vb;
            aa += w * va * va;
            bb += w * vb * vb;
            ab += w * va * vb;
          }
        }
        sum += (2 * ma * mb + 1e-4) * (2 * (ab - ma * mb) + 9e-4) /
               ((ma * ma + mb * mb + 1e-4) * (aa - ma * ma + bb - mb * mb + 9e-4));
      }
    }
  }
  return sum / (3.0 * width * height);
}

double Entropy(double p) {
  if (p <= 0 || p >= 1) return 0;
  return -p * std::log(p) - (1 - p) * std::log(1 - p);
}

// alpha - rendered normal . normal of the depth map, mean over the pixels.
double NormalTerm(const ReferenceMaps& maps, const PinholeView& view) {
  const int width = view.width, height = view.height;
  const auto point = [&](int x, int y) -> Vector3d {
    return maps.expected_depth[y * width + x] *
           Vector3d((x + 0.5 - view.cx) / view.fx, (y + 0.5 - view.cy) / view.fy, 1);
  };
  double sum = 0;
  for (int y = 1; y < height - 1; ++y) {
    for (int x = 1; x < width - 1; ++x) {
      const Vector3d left = point(x - 1, y), right = point(x + 1, y), up = point(x, y - 1),
                     down = point(x, y + 1);
      if (left.z() <= 0 || right.z() <= 0 || up.z() <= 0 || down.z() <= 0) continue;
      const Vector3d normal = (down - up).cross(right - left).normalized();
      const double* n = maps.normal.data() + 3 * (y * width + x);
      sum += maps.alpha[y * width + x] - Vector3d(n[0], n[1], n[2]).dot(normal);
    }
  }
  return sum / (width * height);
}

}  // namespace

std::vector<ReferenceGaussian> ToReference(const Gaussians& gaussians) {
  std::vector<ReferenceGaussian> result(gaussians.size());
  const auto copy = [&](const std::vector<float>& values, int first, size_t count) {
    for (size_t i = 0; i < result.size(); ++i) {
      for (size_t k = 0; k < count; ++k) result[i][first + k] = static_cast<double>(values[i * count + k]);
    }
  };
  copy(gaussians.centre, kRefCentre, 3);
  copy(gaussians.log_scale, kRefLogScale, 2);
  copy(gaussians.rotation, kRefRotation, 4);
  copy(gaussians.opacity_logit, kRefOpacity, 1);
  copy(gaussians.foreground_logit, kRefForeground, 1);
  copy(gaussians.sh_dc, kRefDc, 3);
  copy(gaussians.sh_rest, kRefRest, 3 * kShRestPerChannel);
  return result;
}

Gaussians FromReference(const std::vector<ReferenceGaussian>& gaussians, int sh_degree) {
  Gaussians result;
  result.Resize(gaussians.size());
  result.sh_degree = sh_degree;
  const auto copy = [&](std::vector<float>& values, int first, size_t count) {
    for (size_t i = 0; i < gaussians.size(); ++i) {
      for (size_t k = 0; k < count; ++k) values[i * count + k] = static_cast<float>(gaussians[i][first + k]);
    }
  };
  copy(result.centre, kRefCentre, 3);
  copy(result.log_scale, kRefLogScale, 2);
  copy(result.rotation, kRefRotation, 4);
  copy(result.opacity_logit, kRefOpacity, 1);
  copy(result.foreground_logit, kRefForeground, 1);
  copy(result.sh_dc, kRefDc, 3);
  copy(result.sh_rest, kRefRest, 3 * kShRestPerChannel);
  return result;
}

namespace {

bool IsOfSide(const ReferenceGaussian& g, const RotatingSide& side) {
  const Eigen::Vector3d x(g[kRefCentre], g[kRefCentre + 1], g[kRefCentre + 2]);
  const double from_axis = (x - side.region.axis.point).cross(side.region.axis.direction).norm();
  double apart = 0;
  for (int c = 0; c < 3; ++c) apart += std::abs(0.5 + g[kRefDc + c] / std::sqrt(4 * kPi) - side.color[c]);
  return side.region.Contains(x, 0) && from_axis >= side.inner_radius && apart / 3 <= side.color_tolerance;
}

}  // namespace

ReferenceMaps RenderReference(const std::vector<ReferenceGaussian>& gaussians, const RenderRequest& request,
                              int sh_degree) {
  const PinholeView& view = request.view;
  const ReferenceRule rule = {request.bodies == SceneBodies::kBoth && !request.freeze_foreground,
                              request.bodies};
  std::vector<ReferenceSplat> splats;
  for (const ReferenceGaussian& g : gaussians) {
    ReferenceSplat splat;
    const bool is_object = IsObject(g, rule);
    if (request.drawn == DrawnBody::kForeground && !is_object) continue;
    if (request.drawn == DrawnBody::kBackground && is_object) continue;
    const bool is_side = request.side && IsOfSide(g, *request.side);
    if (request.without_static && !is_object && !is_side &&
        request.without_static->Contains({g[kRefCentre], g[kRefCentre + 1], g[kRefCentre + 2]}, 0))
      continue;
    if (!MakeSplat(g, view, rule, sh_degree, &splat)) continue;
    if (request.hard_foreground) splat.foreground = is_object || is_side ? 1 : 0;
    splats.push_back(splat);
  }
  std::stable_sort(splats.begin(), splats.end(), [](const ReferenceSplat& a, const ReferenceSplat& b) {
    return a.centre.z() < b.centre.z();
  });

  const size_t size = static_cast<size_t>(view.width) * view.height;
  ReferenceMaps maps;
  maps.color.resize(3 * size);
  maps.normal.resize(3 * size);
  for (auto* map :
       {&maps.alpha, &maps.expected_depth, &maps.median_depth, &maps.distortion, &maps.foreground}) {
    map->resize(size);
  }
  for (size_t i = 0; i < size; ++i) {
    const double px = static_cast<double>(i % view.width) + 0.5,
                 py = static_cast<double>(i / view.width) + 0.5;
    double transmittance = 1;
    Vector3d color = Vector3d::Zero(), normal = Vector3d::Zero();
    std::vector<std::pair<double, double>> spread;  // weight, mapped depth
    double depth_sum = 0;
    for (const ReferenceSplat& s : splats) {
      double alpha = 0, depth = 0;
      Meet(s, view, px, py, &alpha, &depth);
      if (alpha < 1.0 / 255) continue;
      const double left = transmittance * (1 - alpha);
      if (left < 1e-4) break;
      const double weight = alpha * transmittance;
      color += weight * s.color;
      normal += weight * (s.normal.dot(s.centre) > 0 ? Vector3d(-s.normal) : s.normal);
      maps.foreground[i] += weight * s.foreground;
      depth_sum += weight * depth;
      spread.emplace_back(weight, 1 - view.near_depth / depth);
      if (transmittance > 0.5 && left <= 0.5) maps.median_depth[i] = depth;
      transmittance = left;
    }
    maps.alpha[i] = 1 - transmittance;
    maps.expected_depth[i] = transmittance < 1 ? depth_sum / (1 - transmittance) : 0;
    for (size_t a = 0; a < spread.size(); ++a) {
      for (size_t b = 0; b < a; ++b) {
        const double difference = spread[a].second - spread[b].second;
        maps.distortion[i] += spread[a].first * spread[b].first * difference * difference;
      }
    }
    for (int c = 0; c < 3; ++c) {
      maps.color[3 * i + c] = color[c] + transmittance * static_cast<double>(request.background_color[c]);
      maps.normal[3 * i + c] = normal[c];
    }
  }
  return maps;
}

LossTerms ReferenceLoss(const std::vector<ReferenceGaussian>& gaussians, const TrainingPhoto& photo,
                        const TrainStep& step, const std::vector<uint32_t>& neighbours, int k) {
  RenderRequest request;
  request.view = photo.view;
  request.bodies = step.bodies;
  request.freeze_foreground = step.freeze_foreground;
  request.background_color = step.background_color;
  const ReferenceMaps maps = RenderReference(gaussians, request, step.sh_degree);
  const int width = photo.view.width, height = photo.view.height;
  const size_t size = static_cast<size_t>(width) * height;
  const bool learns = step.bodies == SceneBodies::kBoth && !step.freeze_foreground;

  std::vector<double> real(3 * size);
  for (size_t i = 0; i < real.size(); ++i) {
    const bool is_cut_out = step.cut_out_mask && !photo.mask.empty() && photo.mask[i / 3] <= 127;
    real[i] = is_cut_out ? static_cast<double>(step.background_color[i % 3]) : photo.image.pixels[i] / 255.0;
  }
  LossTerms loss;
  loss.steps = 1;
  for (size_t i = 0; i < real.size(); ++i) loss.l1 += std::abs(maps.color[i] - real[i]);
  loss.l1 /= static_cast<double>(real.size());
  const LossWeights& w = step.weights;
  if (w.dssim != 0) loss.dssim = 1 - Ssim(maps.color, real, width, height);
  if (w.normal != 0) loss.normal = NormalTerm(maps, photo.view);
  const auto mean = [&](const auto& of) {
    double sum = 0;
    for (size_t i = 0; i < size; ++i) sum += of(i);
    return sum / static_cast<double>(size);
  };
  if (w.distortion != 0) loss.distortion = mean([&](size_t i) { return maps.distortion[i]; });
  if (learns && w.entropy_2d != 0) {
    loss.entropy_2d = mean([&](size_t i) { return Entropy(std::clamp(maps.foreground[i], 1e-6, 1 - 1e-6)); });
  }
  if (learns && w.mask != 0 && !photo.mask.empty()) {
    loss.mask = mean([&](size_t i) {
      return -std::log((photo.mask[i] > 127 ? maps.foreground[i] : 1 - maps.foreground[i]) + 1e-3);
    });
  }
  const auto n = static_cast<double>(gaussians.size());
  if (learns && w.entropy_3d != 0) {
    for (const ReferenceGaussian& g : gaussians) loss.entropy_3d += Entropy(SigmoidOf(g[kRefForeground])) / n;
  }
  if (learns && w.local_consistency != 0) {
    for (size_t i = 0; i < gaussians.size(); ++i) {
      for (int j = 0; j < k; ++j) {
        const double p = SigmoidOf(gaussians[i][kRefForeground]);
        const double q = SigmoidOf(gaussians[neighbours[i * k + j]][kRefForeground]);
        loss.local_consistency += (p * std::log(p / q) + (1 - p) * std::log((1 - p) / (1 - q))) / (n * k);
      }
    }
  }
  const auto weighted = [](float weight, double term) { return static_cast<double>(weight) * term; };
  loss.total = weighted(1 - w.dssim, loss.l1) + weighted(w.dssim, loss.dssim) +
               weighted(w.normal, loss.normal) + weighted(w.distortion, loss.distortion) +
               weighted(w.entropy_2d, loss.entropy_2d) + weighted(w.mask, loss.mask) +
               weighted(w.entropy_3d, loss.entropy_3d) +
               weighted(w.local_consistency, loss.local_consistency);
  return loss;
}

}  // namespace s2gs
