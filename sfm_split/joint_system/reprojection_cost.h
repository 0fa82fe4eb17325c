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
class ReprojectionCost {
 public:
  enum class Kind { kBackground, kTurntable, kFreeObject };
  static constexpr double kBehindCameraError = 1e3;  // [px]

  /// \param camera_r0, object_r0  must outlive the cost; object_r0 for kFreeObject only.
  /// \param spread  the residual is the error over this.
  ReprojectionCost(Kind kind, const Camera& camera, const Eigen::Vector2d& xy,
                   const Eigen::Matrix3d* camera_r0, const Eigen::Matrix3d* object_r0, double spread = 1);

  /// What observations that have all parameter blocks but the point in common share, where these stand.
  struct Frame {
    Eigen::Matrix3d camera_rotation;  ///< camera from world.
    Eigen::Vector3d centre;
    Eigen::Matrix3d turn = Eigen::Matrix3d::Identity();     ///< d x_in_world / d point.
    Eigen::Vector3d on_axis = Eigen::Vector3d::Zero();      ///< kTurntable: the axis' point.
    Eigen::Vector3d direction = Eigen::Vector3d::UnitZ();   ///< kTurntable: the axis', unit.
    double sine = 0, versine = 0;                           ///< kTurntable: of the angle.
    Eigen::Matrix3d by_unnormalised;                        ///< kTurntable: of the axis' direction.
    Eigen::Vector3d translation = Eigen::Vector3d::Zero();  ///< kFreeObject.
    Eigen::Matrix3d camera_left, object_left;               ///< LeftJacobian() of the rotation vectors.
  };
  /// \param with_derivatives  whether it is for derivatives, too.
  Frame FrameAt(double const* const* parameters, bool with_derivatives) const;

  /// In the frame of the same parameters.
  void EvaluateIn(const Frame& frame, double const* const* parameters, double* residuals,
                  double** jacobians) const;
  /// \param jacobians  null, or of each block 2 x its size, row by row, or null.
  void Evaluate(double const* const* parameters, double* residuals, double** jacobians) const {
    EvaluateIn(FrameAt(parameters, jacobians != nullptr), parameters, residuals, jacobians);
  }
  int NumBlocks() const { return Intrinsics() + 2; }
  int SizeOf(int block) const;
  const Eigen::Vector2d& xy() const { return xy_; }

 private:
  // Place of the intrinsics among the blocks; the point follows.
  int Intrinsics() const { return kind_ == Kind::kBackground ? 1 : kind_ == Kind::kTurntable ? 3 : 2; }

  Kind kind_;
  CameraModelId model_;
  int num_intrinsics_;
  Eigen::Vector2d xy_;
  const Eigen::Matrix3d* camera_r0_;
  const Eigen::Matrix3d* object_r0_;
  double spread_;
};

/// The same for Ceres.
class CeresReprojection : public ceres::CostFunction {
 public:
  explicit CeresReprojection(const ReprojectionCost& cost) : cost_(cost) {
    set_num_residuals(2);
    for (int b = 0; b < cost.NumBlocks(); ++b) mutable_parameter_block_sizes()->push_back(cost.SizeOf(b));
  }
  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    cost_.Evaluate(parameters, residuals, jacobians);
    return true;
  }

 private:
  ReprojectionCost cost_;
};

}  // namespace s2gs
