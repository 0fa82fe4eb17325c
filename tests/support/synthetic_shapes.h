#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "sfm_split/base/rigid3.h"

namespace s2gs {

/// origin + t * direction; the direction may have any length but zero.
struct Ray {
  Eigen::Vector3d origin;
  Eigen::Vector3d direction;
};

struct RayHit {
  double t = 0;
  Eigen::Vector3d normal;  ///< of unit length, out of the shape's solid.
};

enum class ShapeKind {
  kBox,       ///< size: half the edges; an edge may be 0 (a plate).
  kSphere,    ///< size.x(): radius.
  kCylinder,  ///< axis z; size.x(): radius, size.z(): half the height.
  kBumpy,     ///< size.x(): mean radius; surface |x| = size.x() * (1 + sum of waves at x / |x|).
};

/// amplitude * sin(frequency . direction + phase)
struct SurfaceWave {
  Eigen::Vector3d frequency;
  double phase = 0;
  double amplitude = 0;
};

/// A closed analytic surface, given in its own frame and placed in another one.
struct Shape {
  ShapeKind kind = ShapeKind::kBox;
  Rigid3 frame_from_shape;
  Eigen::Vector3d size = Eigen::Vector3d::Ones();
  std::vector<SurfaceWave> waves;  ///< kBumpy only.
};

/// The first point with t > t_min where the ray crosses the surface, from outside or inside.
/// Exact to rounding; of a kBumpy shape, a chord shorter than 1e-4 of its radius may be missed.
std::optional<RayHit> Intersect(const Shape& shape, const Ray& ray_in_frame, double t_min = 0);

/// Radius of a kBumpy shape in a direction (of unit length, in the shape's frame).
double BumpyRadius(const Shape& shape, const Eigen::Vector3d& direction);

/// Outward unit normal of a kBumpy shape in a direction, in the shape's frame.
Eigen::Vector3d BumpyNormal(const Shape& shape, const Eigen::Vector3d& direction);

/// Waves for a kBumpy shape that stays the same when turned by 360 / fold degrees about z.
std::vector<SurfaceWave> RandomWaves(uint64_t seed, int fold);

}  // namespace s2gs
