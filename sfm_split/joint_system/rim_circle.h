#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "sfm_split/base/rigid3.h"
#include "sfm_split/scene/projection_jacobians.h"

namespace s2gs {

/// A circle about the table's axis at right angles to it: the rim of a round top. Lengths in world units.
struct RimCircle {
  double height = 0;  ///< of its middle along the axis, from the axis' point.
  double radius = 0;
};

/// How far a circle's picture runs beside a place of a photo, along its normal there, and the derivatives.
struct RimOffset {
  double px = 0;
  Eigen::Matrix<double, 1, 6> by_pose;    ///< (w, C): cam_from_world is exp(w) R about the centre C.
  Eigen::Matrix<double, 1, 4> by_axis;    ///< JointProblem::axis
  Eigen::Matrix<double, 1, 2> by_circle;  ///< height, radius
  Eigen::Matrix<double, 1, Eigen::Dynamic, Eigen::RowMajor, 1, kMaxIntrinsics> by_camera;
};

/// Nothing where the circle is not before the camera. \param axis  as JointProblem has it. \param place  [px]
std::optional<RimOffset> OffsetFromRim(const Camera& camera, const Rigid3& cam_from_world,
                                       const Eigen::Vector4d& axis, const RimCircle& circle,
                                       const Eigen::Vector2d& place);

/// The circle about an axis whose picture runs nearest to places of a photo, in the mean of squares. Nothing
/// where none does. \param axis  as JointProblem has it. \param places  [px]
std::optional<RimCircle> NearestRimCircle(const Camera& camera, const Rigid3& cam_from_world,
                                          const Eigen::Vector4d& axis,
                                          const std::vector<Eigen::Vector2d>& places);

}  // namespace s2gs
