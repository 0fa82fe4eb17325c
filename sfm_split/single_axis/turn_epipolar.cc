#include "sfm_split/single_axis/turn_epipolar.h"

#include <Eigen/Geometry>

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using Eigen::VectorXd;

}  // namespace

AxisFrame FrameAcross(const Vector3d& direction, const Vector3d& sight) {
  Vector3d b1 = direction.cross(sight);
  if (b1.norm() < 1e-3 * sight.norm()) b1 = direction.unitOrthogonal();
  b1.normalize();
  return {b1, direction.cross(b1)};
}

TurntableAxis MovedAxis(const AxisRays& rays, const TurntableAxis& axis, const AxisFrame& frame,
                        const VectorXd& step) {
  TurntableAxis moved;
  moved.direction = (axis.direction + step(0) * frame.b1 + step(1) * frame.b2).normalized();
  moved.point = axis.point + rays.radius * step(2) * frame.b1;
  if (rays.scale_observable) moved.point += rays.radius * step(3) * frame.b2;
  return moved;
}

bool MeetInFront(const RayCamera& first, const RayCamera& second, const TurntableAxis& axis,
                 const Matrix3d& turn, const RayMatch& match) {
  const Vector3d u = turn * match.first.in_world;
  const Vector3d& v = match.second.in_world;
  const Vector3d gap = (second.centre - axis.point) - turn * (first.centre - axis.point);
  const double uu = u.squaredNorm();
  const double vv = v.squaredNorm();
  const double uv = u.dot(v);
  // s u - t v = gap in the least-squares sense; the determinant uu vv - uv^2 is positive.
  const double s = vv * u.dot(gap) - uv * v.dot(gap);
  const double t = uv * u.dot(gap) - uu * v.dot(gap);
  return s > 0 && t > 0;
}

}  // namespace s2gs
