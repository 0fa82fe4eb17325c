#pragma once

#include <ceres/cost_function.h>

#include <Eigen/Core>

#include "sfm_split/scene/camera_model.h"

namespace s2gs {

/// Reprojection error [px] of one observation with analytic derivatives. Parameter blocks:
///   kBackground:  camera pose (6), intrinsics, point (3)
///   kTurntable:   camera pose (6), axis (4), angle (1), intrinsics, point (3)
///   kFreeObject:  camera pose (6), object pose (6), intrinsics, point (3)
/// A camera pose is (w, C): cam_from_world rotation exp(w) R0 with R0 held outside, centre C. An object pose
/// is (w, t): x_in_world = exp(w) R0 x + t. An axis is JointProblem's. Points behind the camera give a large
/// constant error without derivative, so that one bad point cannot stop the others.
class ReprojectionCost : public ceres::CostFunction {
 public:
  enum class Kind { kBackground, kTurntable, kFreeObject };
  static constexpr double kBehindCameraError = 1e3;  // [px]

  /// \param camera_r0, object_r0  must outlive the cost; object_r0 for kFreeObject only.
  /// \param spread  the residual is the error over this.
  ReprojectionCost(Kind kind, const Camera& camera, const Eigen::Vector2d& xy,
                   const Eigen::Matrix3d* camera_r0, const Eigen::Matrix3d* object_r0, double spread = 1);

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override;
  const Eigen::Vector2d& xy() const { return xy_; }

 private:
  Kind kind_;
  CameraModelId model_;
  Eigen::Vector2d xy_;
  const Eigen::Matrix3d* camera_r0_;
  const Eigen::Matrix3d* object_r0_;
  double spread_;
};

}  // namespace s2gs
