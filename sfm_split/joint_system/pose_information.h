#pragma once

#include <Eigen/Core>
#include <vector>

#include "sfm_split/joint_system/joint_options.h"
#include "sfm_split/joint_system/joint_problem.h"

namespace s2gs {

/// What the object's keypoints say of one image's object pose, all else being held. Of (w, t), with which
/// x_in_world = exp(w) R x + t, R the rotation that there is.
struct PoseInformation {
  Eigen::Matrix<double, 6, 6> information = Eigen::Matrix<double, 6, 6>::Zero();
};

/// By image; zeros where no keypoint sees the object.
/// \param problem   with free object poses.
/// \param sigma_px  standard deviation of a keypoint's coordinate.
std::vector<PoseInformation> InformationOfPoses(const JointProblem& problem, const JointOptions& options,
                                                double sigma_px);

}  // namespace s2gs
