#include "sfm_split/joint_system/reprojection_cost.h"

#include <algorithm>
#include <cmath>

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
      num_intrinsics_(static_cast<int>(camera.params.size())),
      xy_(xy),
      camera_r0_(camera_r0),
      object_r0_(object_r0),
      spread_(spread) {}

int ReprojectionCost::SizeOf(int block) const {
  if (block == 0) return 6;
  if (block == Intrinsics()) return num_intrinsics_;
  if (block > Intrinsics()) return 3;
  if (kind_ == Kind::kFreeObject) return 6;
  return block == 1 ? 4 : 1;
}

ReprojectionCost::Frame ReprojectionCost::FrameAt(double const* const* parameters,
                                                  bool with_derivatives) const {
  Frame frame;
  const Vector3d camera_w = Eigen::Map<const Vector3d>(parameters[0]);
  frame.centre = Eigen::Map<const Vector3d>(parameters[0] + 3);
  frame.camera_rotation = ExpRotation<double>(camera_w) * *camera_r0_;
  if (with_derivatives) frame.camera_left = LeftJacobian<double>(camera_w);
  if (kind_ == Kind::kTurntable) {
    const double* axis = parameters[1];
    const double angle = parameters[2][0];
    frame.direction << axis[0], axis[1], 1;
    const double length = frame.direction.norm();
    frame.direction /= length;
    frame.on_axis << axis[2], axis[3], 0;
    frame.turn = RotationAbout<double>(frame.direction, angle);
    const double half_sine = std::sin(0.5 * angle);
    frame.sine = std::sin(angle);
    frame.versine = 2 * half_sine * half_sine;
    frame.by_unnormalised = (Matrix3d::Identity() - frame.direction * frame.direction.transpose()) / length;
  } else if (kind_ == Kind::kFreeObject) {
    const Vector3d object_w = Eigen::Map<const Vector3d>(parameters[1]);
    frame.turn = ExpRotation<double>(object_w) * *object_r0_;
    frame.translation = Eigen::Map<const Vector3d>(parameters[1] + 3);
    if (with_derivatives) frame.object_left = LeftJacobian<double>(object_w);
  }
  return frame;
}

void ReprojectionCost::EvaluateIn(const Frame& frame, double const* const* parameters, double* residuals,
                                  double** jacobians) const {
  const int intrinsics = Intrinsics();
  const Eigen::Map<const Vector3d> point(parameters[intrinsics + 1]);

  // The point in the world, with what is needed again for its derivatives.
  Vector3d in_world = point;
  Vector3d from_axis = Vector3d::Zero();  // the point relative to the axis' point, before the turn
  Vector3d turned = Vector3d::Zero();     // the same after the turn
  if (kind_ == Kind::kTurntable) {
    from_axis = point - frame.on_axis;
    turned = frame.turn * from_axis;
    in_world = frame.on_axis + turned;
  } else if (kind_ == Kind::kFreeObject) {
    turned = frame.turn * point;
    in_world = turned + frame.translation;
  }
  const Vector3d in_cam = frame.camera_rotation * (in_world - frame.centre);

  Vector2d xy;
  Matrix23 by_cam;
  IntrinsicsJacobian by_intrinsics;
  const bool want = jacobians != nullptr;
  Eigen::Map<Vector2d> residual(residuals);
  if (!ProjectWithJacobians(model_, parameters[intrinsics], in_cam, &xy, want ? &by_cam : nullptr,
                            want && jacobians[intrinsics] != nullptr ? &by_intrinsics : nullptr)) {
    residual.setConstant(kBehindCameraError);
    if (want) {
      for (int block = 0; block < NumBlocks(); ++block) {
        if (jacobians[block] != nullptr) std::fill_n(jacobians[block], 2 * SizeOf(block), 0.0);
      }
    }
    return;
  }
  residual = (xy - xy_) / spread_;
  if (!want) return;
  by_cam /= spread_;
  if (jacobians[intrinsics] != nullptr) by_intrinsics /= spread_;

  using Rows3 = Eigen::Matrix<double, 2, 3, Eigen::RowMajor>;
  using Rows4 = Eigen::Matrix<double, 2, 4, Eigen::RowMajor>;
  using Rows6 = Eigen::Matrix<double, 2, 6, Eigen::RowMajor>;
  const Matrix23 by_world = by_cam * frame.camera_rotation;
  if (jacobians[0] != nullptr) {
    Eigen::Map<Rows6> by_pose(jacobians[0]);
    by_pose.leftCols<3>() = -by_cam * CrossMatrix<double>(in_cam) * frame.camera_left;
    by_pose.rightCols<3>() = -by_world;
  }
  if (kind_ == Kind::kTurntable && jacobians[1] != nullptr) {
    // d (R(n, t) u) / d n = -sin t [u]x + (1 - cos t) (n u^T + (n . u) I)
    const Matrix3d by_direction = -frame.sine * CrossMatrix<double>(from_axis) +
                                  frame.versine * (frame.direction * from_axis.transpose() +
                                                   frame.direction.dot(from_axis) * Matrix3d::Identity());
    Eigen::Map<Rows4> by_axis(jacobians[1]);
    by_axis.leftCols<2>() = by_world * (by_direction * frame.by_unnormalised.leftCols<2>());
    by_axis.rightCols<2>() = by_world * (Matrix3d::Identity() - frame.turn).leftCols<2>();
  }
  if (kind_ == Kind::kTurntable && jacobians[2] != nullptr) {
    Eigen::Map<Vector2d> by_angle(jacobians[2]);
    by_angle = by_world * frame.direction.cross(turned);
  }
  if (kind_ == Kind::kFreeObject && jacobians[1] != nullptr) {
    Eigen::Map<Rows6> by_pose(jacobians[1]);
    by_pose.leftCols<3>() = -by_world * CrossMatrix<double>(turned) * frame.object_left;
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
      by_point = by_world * frame.turn;
    }
  }
}

}  // namespace s2gs
