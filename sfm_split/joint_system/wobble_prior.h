#pragma once

#include <Eigen/Core>
#include <optional>

#include "sfm_split/joint_system/joint_options.h"
#include "sfm_split/joint_system/joint_problem.h"

namespace s2gs {

/// How far the object's poses lie from pure turns about the problem's axis, as the poses themselves tell:
/// each pose's deviations and how well its keypoints know them, by expectation and maximisation over all
/// images (the variance is the mean of squared deviations and of their own variances under the prior). Poses
/// that few keypoints see then lie as close to the turn as those do that many see.
/// \param problem   with free object poses.
/// \param sigma_px  standard deviation of a keypoint's coordinate.
/// Nothing where fewer than three images see the object.
std::optional<WobblePrior> FitWobble(const JointProblem& problem, const JointOptions& options,
                                     double sigma_px);

/// A pose's deviation from the nearest pure turn about an axis.
struct WobbleOfPose {
  Eigen::Vector3d tilt_rad = Eigen::Vector3d::Zero();  ///< rotation vector, across the axis.
  Eigen::Vector3d shift = Eigen::Vector3d::Zero();     ///< of the object's point on the axis, in the world.
};
WobbleOfPose DeviationFromTurn(const Eigen::Vector3d& axis_direction, const Eigen::Vector3d& axis_point,
                               const Rigid3& world_from_object);

}  // namespace s2gs
