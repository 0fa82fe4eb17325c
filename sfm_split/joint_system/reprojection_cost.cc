#include "sfm_split/joint_system/reprojection_cost.h"

#include "sfm_split/base/error.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/scene/camera_projection.h"
#include "sfm_split/scene/projection_jacobians.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;
using Matrix23 = Eigen::Matrix<double, 2, 3>;

}  // namespace

ReprojectionCost::ReprojectionCost(Kind kind, const Camera& camera, const Vector2d& xy,
                                   const Matrix3d* camera_r0, const Matrix3d* object_r0, double spread)
    : kind_(kind),
      model_(camera.model),
      xy_(xy),
      camera_r0_(camera_r0),
      object_r0_(object_r0),
      spread_(spread) {
  set_num_residuals(2);
  std::vector<int32_t>& sizes = *mutable_parameter_block_sizes();
  sizes.reserve(5);
  sizes.push_back(6);
  if (kind == Kind::kTurntable) {
    sizes.push_back(4);
    sizes.push_back(1);
  } else if (kind == Kind::kFreeObject) {
    sizes.push_back(6);
  }
  sizes.push_back(static_cast<int32_t>(camera.params.size()));
  sizes.push_back(3);
}

bool ReprojectionCost::Evaluate(double const* const* parameters, double* residuals,
                                double** jacobians) const {
  const Eigen::Map<const Vector3d> camera_w(parameters[0]);
  const Eigen::Map<const Vector3d> centre(parameters[0] + 3);
  const int intrinsics = kind_ == Kind::kBackground ? 1 : (kind_ == Kind::kTurntable ? 3 : 2);
  const Eigen::Map<const Vector3d> point(parameters[intrinsics + 1]);

  // The point in the world, with what is needed again for its derivatives.
  Vector3d in_world = point;
  Matrix3d turn = Matrix3d::Identity();    // d in_world / d point
  Vector3d direction = Vector3d::UnitZ();  // of the axis, unit
  Vector3d from_axis = Vector3d::Zero();   // the point relative to the axis' point, before the turn
  Vector3d turned = Vector3d::Zero();      // the same after the turn
  double axis_length = 1;
  if (kind_ == Kind::kTurntable) {
    const double* axis = parameters[1];
    direction << axis[0], axis[1], 1;
    axis_length = direction.norm();
    direction /= axis_length;
    const Vector3d on_axis(axis[2], axis[3], 0);
    turn = RotationAbout<double>(direction, parameters[2][0]);
    from_axis = point - on_axis;
    turned = turn * from_axis;
    in_world = on_axis + turned;
  } else if (kind_ == Kind::kFreeObject) {
    turn = ExpRotation<double>(Vector3d(Eigen::Map<const Vector3d>(parameters[1]))) * *object_r0_;
    turned = turn * point;
    in_world = turned + Eigen::Map<const Vector3d>(parameters[1] + 3);
  }
  const Matrix3d rotation = ExpRotation<double>(Vector3d(camera_w)) * *camera_r0_;
  const Vector3d in_cam = rotation * (in_world - centre);

  Vector2d xy;
  Matrix23 by_cam;
  Eigen::Matrix<double, 2, Eigen::Dynamic> by_intrinsics;
  const bool want = jacobians != nullptr;
  Eigen::Map<Vector2d> residual(residuals);
  if (!ProjectWithJacobians(model_, parameters[intrinsics], in_cam, &xy, want ? &by_cam : nullptr,
                            want && jacobians[intrinsics] != nullptr ? &by_intrinsics : nullptr)) {
    residual.setConstant(kBehindCameraError);
    if (want) {
      for (size_t block = 0; block < parameter_block_sizes().size(); ++block) {
        if (jacobians[block] != nullptr)
          std::fill_n(jacobians[block], 2 * parameter_block_sizes()[block], 0.0);
      }
    }
    return true;
  }
  residual = (xy - xy_) / spread_;
  if (!want) return true;
  by_cam /= spread_;
  if (jacobians[intrinsics] != nullptr) by_intrinsics /= spread_;

  using Rows3 = Eigen::Matrix<double, 2, 3, Eigen::RowMajor>;
  using Rows4 = Eigen::Matrix<double, 2, 4, Eigen::RowMajor>;
  using Rows6 = Eigen::Matrix<double, 2, 6, Eigen::RowMajor>;
  const Matrix23 by_world = by_cam * rotation;
  if (jacobians[0] != nullptr) {
    Eigen::Map<Rows6> by_pose(jacobians[0]);
    by_pose.leftCols<3>() = -by_cam * CrossMatrix<double>(in_cam) * LeftJacobian<double>(Vector3d(camera_w));
    by_pose.rightCols<3>() = -by_world;
  }
  if (kind_ == Kind::kTurntable && jacobians[1] != nullptr) {
    // d (R(n, t) u) / d n = -sin t [u]x + (1 - cos t) (n u^T + (n . u) I)
    const double angle = parameters[2][0];
    const double half_sine = std::sin(0.5 * angle);
    const Matrix3d by_direction =
        -std::sin(angle) * CrossMatrix<double>(from_axis) +
        2 * half_sine * half_sine *
            (direction * from_axis.transpose() + direction.dot(from_axis) * Matrix3d::Identity());
    const Matrix3d of_unit = (Matrix3d::Identity() - direction * direction.transpose()) / axis_length;
    Eigen::Map<Rows4> by_axis(jacobians[1]);
    by_axis.leftCols<2>() = by_world * (by_direction * of_unit.leftCols<2>());
    by_axis.rightCols<2>() = by_world * (Matrix3d::Identity() - turn).leftCols<2>();
  }
  if (kind_ == Kind::kTurntable && jacobians[2] != nullptr) {
    Eigen::Map<Vector2d> by_angle(jacobians[2]);
    by_angle = by_world * direction.cross(turned);
  }
  if (kind_ == Kind::kFreeObject && jacobians[1] != nullptr) {
    Eigen::Map<Rows6> by_pose(jacobians[1]);
    by_pose.leftCols<3>() = -by_world * CrossMatrix<double>(turned) *
                            LeftJacobian<double>(Vector3d(Eigen::Map<const Vector3d>(parameters[1])));
    by_pose.rightCols<3>() = by_world;
  }
  if (jacobians[intrinsics] != nullptr) {
    Eigen::Map<Eigen::Matrix<double, 2, Eigen::Dynamic, Eigen::RowMajor>>(
        jacobians[intrinsics], 2, by_intrinsics.cols()) = by_intrinsics;
  }
  if (jacobians[intrinsics + 1] != nullptr) {
    Eigen::Map<Rows3> by_point(jacobians[intrinsics + 1]);
    if (kind_ == Kind::kBackground) {
      by_point = by_world;
    } else {
      by_point = by_world * turn;
    }
  }
  return true;
}

}  // namespace s2gs
