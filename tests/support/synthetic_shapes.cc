#include "tests/support/synthetic_shapes.h"

#include <algorithm>
#include <cmath>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/infinity.h"
#include "tests/support/random_numbers.h"

namespace s2gs {
namespace {

/// Both roots of a t^2 + 2 b t + c = 0 in order, free of cancellation; nothing when there are none.
std::optional<std::pair<double, double>> Roots(double a, double b, double c) {
  const double discriminant = b * b - a * c;
  if (discriminant < 0 || a == 0) return std::nullopt;
  const double q = -(b + std::copysign(std::sqrt(discriminant), b));
  const double root1 = q / a;
  const double root2 = q != 0 ? c / q : root1;
  return std::make_pair(std::min(root1, root2), std::max(root1, root2));
}

std::optional<RayHit> IntersectBox(const Eigen::Vector3d& half, const Ray& ray, double t_min) {
  double enter = -kInfinity;
  double leave = kInfinity;
  int enter_axis = 0;
  int leave_axis = 0;
  for (int axis = 0; axis < 3; ++axis) {
    const double d = ray.direction[axis];
    const double o = ray.origin[axis];
    if (d == 0) {
      if (std::abs(o) > half[axis]) return std::nullopt;
      continue;
    }
    const double t1 = (-std::copysign(half[axis], d) - o) / d;
    const double t2 = (std::copysign(half[axis], d) - o) / d;
    if (t1 > enter) enter = t1, enter_axis = axis;
    if (t2 < leave) leave = t2, leave_axis = axis;
  }
  if (enter > leave) return std::nullopt;
  RayHit hit;
  hit.normal.setZero();
  if (enter > t_min) {
    hit.t = enter;
    hit.normal[enter_axis] = -std::copysign(1.0, ray.direction[enter_axis]);
  } else if (leave > t_min && leave < kInfinity) {
    hit.t = leave;
    hit.normal[leave_axis] = std::copysign(1.0, ray.direction[leave_axis]);
  } else {
    return std::nullopt;
  }
  return hit;
}

std::optional<RayHit> IntersectSphere(double radius, const Ray& ray, double t_min) {
  const auto roots = Roots(ray.direction.squaredNorm(), ray.direction.dot(ray.origin),
                           ray.origin.squaredNorm() - radius * radius);
  if (!roots || roots->second <= t_min) return std::nullopt;
  const double t = roots->first > t_min ? roots->first : roots->second;
  return RayHit{t, (ray.origin + t * ray.direction).normalized()};
}

std::optional<RayHit> IntersectCylinder(double radius, double half_height, const Ray& ray, double t_min) {
  RayHit nearest{kInfinity, Eigen::Vector3d::UnitZ()};
  if (ray.direction.z() != 0) {
    for (const double side : {-1.0, 1.0}) {
      const double t = (side * half_height - ray.origin.z()) / ray.direction.z();
      const Eigen::Vector3d x = ray.origin + t * ray.direction;
      if (t > t_min && t < nearest.t && x.head<2>().squaredNorm() <= radius * radius) {
        nearest = {t, Eigen::Vector3d(0, 0, side)};
      }
    }
  }
  const Eigen::Vector2d d = ray.direction.head<2>();
  const Eigen::Vector2d o = ray.origin.head<2>();
  if (const auto roots = Roots(d.squaredNorm(), d.dot(o), o.squaredNorm() - radius * radius)) {
    for (const double t : {roots->first, roots->second}) {
      const Eigen::Vector3d x = ray.origin + t * ray.direction;
      if (t > t_min && t < nearest.t && std::abs(x.z()) <= half_height) {
        nearest = {t, Eigen::Vector3d(x.x(), x.y(), 0).normalized()};
      }
    }
  }
  if (nearest.t == kInfinity) return std::nullopt;
  return nearest;
}

/// Sphere tracing: f(x) = |x| - r(x / |x|) changes by at most `slope` per unit of length wherever the surface
/// can be, so no step of |f| / slope passes it.
std::optional<RayHit> IntersectBumpy(const Shape& shape, const Ray& ray, double t_min) {
  double amplitudes = 0;
  double slopes = 0;
  for (const SurfaceWave& wave : shape.waves) {
    amplitudes += std::abs(wave.amplitude);
    slopes += std::abs(wave.amplitude) * wave.frequency.norm();
  }
  S2GS_INVARIANT(amplitudes < 1);
  const double inner_radius = shape.size.x() * (1 - amplitudes);
  const double outer_radius = shape.size.x() * (1 + amplitudes);
  const double slope = std::hypot(1, slopes / (1 - amplitudes));
  const double speed = ray.direction.norm();
  const auto roots = Roots(speed * speed, ray.direction.dot(ray.origin),
                           ray.origin.squaredNorm() - outer_radius * outer_radius);
  if (!roots || roots->second <= t_min) return std::nullopt;
  const auto height = [&](double t) {
    const Eigen::Vector3d x = ray.origin + t * ray.direction;
    const double length = x.norm();
    if (length < inner_radius) return length - inner_radius;
    return length - BumpyRadius(shape, x / length);
  };
  double t0 = std::max(roots->first, t_min);
  double height0 = height(t0);
  const bool start_outside = height0 > 0;
  // Grazing rays are given up to what this resolves.
  const double least_step = 1e-4 * shape.size.x() / speed;
  while (t0 < roots->second) {
    double t1 = t0 + std::max(std::abs(height0) / (slope * speed), least_step);
    height0 = height(t1);
    if ((height0 > 0) == start_outside) {
      t0 = t1;
      continue;
    }
    while (true) {
      const double middle = 0.5 * (t0 + t1);
      if (middle <= t0 || middle >= t1) break;
      ((height(middle) > 0) == start_outside ? t0 : t1) = middle;
    }
    return RayHit{t1, BumpyNormal(shape, (ray.origin + t1 * ray.direction).normalized())};
  }
  return std::nullopt;
}

}  // namespace

std::optional<RayHit> Intersect(const Shape& shape, const Ray& ray_in_frame, double t_min) {
  const Eigen::Quaterniond shape_from_frame = shape.frame_from_shape.rotation.conjugate();
  const Ray ray{shape_from_frame * (ray_in_frame.origin - shape.frame_from_shape.translation),
                shape_from_frame * ray_in_frame.direction};
  std::optional<RayHit> hit;
  switch (shape.kind) {
    case ShapeKind::kBox:
      hit = IntersectBox(shape.size, ray, t_min);
      break;
    case ShapeKind::kSphere:
      hit = IntersectSphere(shape.size.x(), ray, t_min);
      break;
    case ShapeKind::kCylinder:
      hit = IntersectCylinder(shape.size.x(), shape.size.z(), ray, t_min);
      break;
    case ShapeKind::kBumpy:
      hit = IntersectBumpy(shape, ray, t_min);
      break;
  }
  if (hit) hit->normal = shape.frame_from_shape.rotation * hit->normal;
  return hit;
}

double BumpyRadius(const Shape& shape, const Eigen::Vector3d& direction) {
  double sum = 1;
  for (const SurfaceWave& wave : shape.waves) {
    sum += wave.amplitude * std::sin(wave.frequency.dot(direction) + wave.phase);
  }
  return shape.size.x() * sum;
}

Eigen::Vector3d BumpyNormal(const Shape& shape, const Eigen::Vector3d& direction) {
  // The gradient of |x| - r(x / |x|), where r's own gradient g enters through the tangent plane of d = x /
  // |x|: d - (g - d (d . g)) / |x|.
  Eigen::Vector3d gradient = Eigen::Vector3d::Zero();
  for (const SurfaceWave& wave : shape.waves) {
    gradient += wave.amplitude * std::cos(wave.frequency.dot(direction) + wave.phase) * wave.frequency;
  }
  gradient *= shape.size.x();
  const Eigen::Vector3d tangential = gradient - direction * direction.dot(gradient);
  return (direction - tangential / BumpyRadius(shape, direction)).normalized();
}

std::vector<SurfaceWave> RandomWaves(uint64_t seed, int fold) {
  S2GS_INVARIANT(fold >= 1);
  RandomNumbers random(seed, 0x6a09);
  const int base_waves = std::max(1, 6 / fold);
  std::vector<SurfaceWave> waves;
  for (int i = 0; i < base_waves; ++i) {
    const Eigen::Vector3d frequency = random.Uniform(2.5, 6) * random.Direction();
    const double phase = random.Uniform(0, 2 * kPi);
    for (int k = 0; k < fold; ++k) {
      const Eigen::AngleAxisd turn(2 * kPi * k / fold, Eigen::Vector3d::UnitZ());
      waves.push_back({turn * frequency, phase, 0.25 / (base_waves * fold)});
    }
  }
  return waves;
}

}  // namespace s2gs
