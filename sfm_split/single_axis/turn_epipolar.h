#pragma once

#include <ceres/jet.h>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>

#include "sfm_split/base/rotation.h"
#include "sfm_split/base/sampson_error.h"
#include "sfm_split/single_axis/single_axis_rays.h"

namespace s2gs {

// The epipolar geometry between two images that the table turned between, and how it changes with the axis.

/// Directions across an axis: b1 across the line of sight too, so that with one camera position a move along
/// b1 can be seen and one along b2 cannot.
struct AxisFrame {
  Eigen::Vector3d b1;
  Eigen::Vector3d b2;
};

AxisFrame FrameAcross(const Eigen::Vector3d& direction, const Eigen::Vector3d& sight);

/// The axis after a Gauss-Newton step: direction along b1 and b2, point along b1 and, where the scale is
/// observable, b2, in units of the object's radius.
TurntableAxis MovedAxis(const AxisRays& rays, const TurntableAxis& axis, const AxisFrame& frame,
                        const Eigen::VectorXd& step);

/// The epipolar matrix of rays in the cameras' frames, for a turn by `angle` between the images.
template <typename T>
Eigen::Matrix<T, 3, 3> EssentialOfTurn(const RayCamera& first, const RayCamera& second,
                                       const Eigen::Matrix<T, 3, 1>& direction,
                                       const Eigen::Matrix<T, 3, 1>& point, const T& angle) {
  using V = Eigen::Matrix<T, 3, 1>;
  using M = Eigen::Matrix<T, 3, 3>;
  const M turn = RotationAbout<T>(direction, angle);
  const M between = turn * CrossMatrix<T>(V(first.centre.cast<T>() - point)) -
                    CrossMatrix<T>(V(second.centre.cast<T>() - point)) * turn;
  return second.from_world.cast<T>() * between * first.from_world.transpose().cast<T>();
}

/// Sampson's error of a match of rays, in units of their plane z = 1.
template <typename T>
T SampsonError(const Eigen::Matrix<T, 3, 3>& e, const RayMatch& match) {
  return SampsonError<T>(e, match.first.in_cam, match.second.in_cam);
}

/// Both depths of the point where the turned first ray passes the second are positive.
/// \param turn  by the angle between the images, about the axis.
bool MeetInFront(const RayCamera& first, const RayCamera& second, const TurntableAxis& axis,
                 const Eigen::Matrix3d& turn, const RayMatch& match);

/// Calls accumulate(residual [px], derivative by (axis step, angle), weight) for every match of a
/// pair.
template <typename Accumulate>
void LinearizePair(const AxisRays& rays, const RayPair& pair, const TurntableAxis& axis,
                   const AxisFrame& frame, double angle, double scale_px, const Accumulate& accumulate) {
  using Jet = ceres::Jet<double, 5>;
  using V = Eigen::Matrix<Jet, 3, 1>;
  V direction = axis.direction.cast<Jet>();
  direction += V(Jet(0, 0) * frame.b1.cast<Jet>() + Jet(0, 1) * frame.b2.cast<Jet>());
  direction.normalize();
  V point = axis.point.cast<Jet>();
  point += V(Jet(0, 2) * Jet(rays.radius) * frame.b1.cast<Jet>());
  if (rays.scale_observable) point += V(Jet(0, 3) * Jet(rays.radius) * frame.b2.cast<Jet>());
  const Eigen::Matrix<Jet, 3, 3> e = EssentialOfTurn<Jet>(
      rays.cameras[pair.image1], rays.cameras[pair.image2], direction, point, Jet(angle, 4));
  for (const RayMatch& match : pair.matches) {
    const Jet error = Jet(pair.focal) * SampsonError<Jet>(e, match);
    if (!std::isfinite(error.a) || !error.v.allFinite()) continue;
    const double ratio = error.a / scale_px;
    const double weight = 1 / ((1 + ratio * ratio) * (1 + ratio * ratio));  // Geman-McClure: far ones vanish
    accumulate(error.a, error.v, weight);
  }
}

}  // namespace s2gs
