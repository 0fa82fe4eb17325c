#pragma once

#include <Eigen/Core>

#include "sfm_split/scene/camera_model.h"

namespace s2gs {

/// Of a camera model's most parameters.
inline constexpr int kMaxIntrinsics = 12;
/// A pixel's derivatives by a camera's parameters; on the stack.
using IntrinsicsJacobian = Eigen::Matrix<double, 2, Eigen::Dynamic, Eigen::ColMajor, 2, kMaxIntrinsics>;

/// Projects a point and differentiates: by hand for the pinhole and simple radial models, by dual numbers for
/// the rest.
/// \param jacobian_x       2x3, or null.
/// \param jacobian_params  2 x (number of parameters), or null.
/// \return  false for points that are not clearly in front of the camera plane.
bool ProjectWithJacobians(CameraModelId model, const double* params, const Eigen::Vector3d& x_in_cam,
                          Eigen::Vector2d* xy, Eigen::Matrix<double, 2, 3>* jacobian_x,
                          IntrinsicsJacobian* jacobian_params);

}  // namespace s2gs
