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

}  // namespace s2gs
