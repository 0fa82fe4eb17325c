#include "sfm_split/reprojection_cost.h"

#include <ceres/jet.h>

#include <array>

#include "sfm_split/camera_projection.h"
#include "sfm_split/error.h"
#include "sfm_split/rotation.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;
using Matrix23 = Eigen::Matrix<double, 2, 3>;

// Flatter rays than this are behind the camera, as far as numbers go.
constexpr double kMinDepthOverDistance = 1e-6;
constexpr int kMaxIntrinsics = 12;

bool ProjectRadial(bool one_focal, int num_radial, const double* params, const Vector3d& x, Vector2d* xy,
                   Matrix23* jacobian_x, Eigen::Matrix<double, 2, Eigen::Dynamic>* jacobian_params) {
  const double fx = params[0];
  const double fy = params[one_focal ? 0 : 1];
  const int principal = one_focal ? 1 : 2;
  const double k1 = num_radial > 0 ? params[principal + 2] : 0;
  const double k2 = num_radial > 1 ? params[principal + 3] : 0;
  const double inverse_z = 1 / x.z();
  const double u = x.x() * inverse_z;
  const double v = x.y() * inverse_z;
  const double r2 = u * u + v * v;
  const double radial = 1 + r2 * (k1 + r2 * k2);
  *xy << fx * u * radial + params[principal], fy * v * radial + params[principal + 1];
  if (jacobian_x != nullptr) {
    const double slope = 2 * (k1 + 2 * k2 * r2);
    const double du_du = radial + slope * u * u;
    const double dv_dv = radial + slope * v * v;
    const double cross = slope * u * v;
    *jacobian_x << fx * du_du * inverse_z, fx * cross * inverse_z, -fx * (du_du * u + cross * v) * inverse_z,
        fy * cross * inverse_z, fy * dv_dv * inverse_z, -fy * (cross * u + dv_dv * v) * inverse_z;
  }
  if (jacobian_params != nullptr) {
    jacobian_params->setZero(2, principal + 2 + num_radial);
    (*jacobian_params)(0, 0) = u * radial;
    (*jacobian_params)(1, one_focal ? 0 : 1) = v * radial;
    (*jacobian_params)(0, principal) = 1;
    (*jacobian_params)(1, principal + 1) = 1;
    for (int k = 0; k < num_radial; ++k) {
      const double power = k == 0 ? r2 : r2 * r2;
      (*jacobian_params)(0, principal + 2 + k) = fx * u * power;
      (*jacobian_params)(1, principal + 2 + k) = fy * v * power;
    }
  }
  return true;
}

bool ProjectByJets(CameraModelId model, const double* params, const Vector3d& x, Vector2d* xy,
                   Matrix23* jacobian_x, Eigen::Matrix<double, 2, Eigen::Dynamic>* jacobian_params) {
  using Jet = ceres::Jet<double, 3 + kMaxIntrinsics>;
  const int num_params = static_cast<int>(InfoOf(model).NumParams());
  S2GS_INVARIANT(num_params <= kMaxIntrinsics);
  std::array<Jet, kMaxIntrinsics> jet_params;
  for (int k = 0; k < num_params; ++k) jet_params[k] = Jet(params[k], 3 + k);
  const std::array<Jet, 3> jet_x = {Jet(x.x(), 0), Jet(x.y(), 1), Jet(x.z(), 2)};
  std::array<Jet, 2> jet_xy;
  if (!ProjectPoint(model, jet_params.data(), jet_x.data(), jet_xy.data())) return false;
  if (jacobian_params != nullptr) jacobian_params->resize(2, num_params);
  for (int row = 0; row < 2; ++row) {
    (*xy)(row) = jet_xy[row].a;
    if (jacobian_x != nullptr) jacobian_x->row(row) = jet_xy[row].v.head<3>().transpose();
    if (jacobian_params != nullptr) {
      jacobian_params->row(row) = jet_xy[row].v.segment(3, num_params).transpose();
    }
  }
  return true;
}

}  // namespace

bool ProjectWithJacobians(CameraModelId model, const double* params, const Vector3d& x_in_cam, Vector2d* xy,
                          Matrix23* jacobian_x, Eigen::Matrix<double, 2, Eigen::Dynamic>* jacobian_params) {
  if (!(x_in_cam.z() > kMinDepthOverDistance * x_in_cam.norm())) return false;
  switch (model) {
    case CameraModelId::kSimplePinhole:
      return ProjectRadial(true, 0, params, x_in_cam, xy, jacobian_x, jacobian_params);
    case CameraModelId::kPinhole:
      return ProjectRadial(false, 0, params, x_in_cam, xy, jacobian_x, jacobian_params);
    case CameraModelId::kSimpleRadial:
      return ProjectRadial(true, 1, params, x_in_cam, xy, jacobian_x, jacobian_params);
    case CameraModelId::kRadial:
      return ProjectRadial(true, 2, params, x_in_cam, xy, jacobian_x, jacobian_params);
    default:
      return ProjectByJets(model, params, x_in_cam, xy, jacobian_x, jacobian_params);
  }
}

ReprojectionCost::ReprojectionCost(Kind kind, const Camera& camera, const Vector2d& xy,
                                   const Matrix3d* camera_r0, const Matrix3d* object_r0)
    : kind_(kind), model_(camera.model), xy_(xy), camera_r0_(camera_r0), object_r0_(object_r0) {
  set_num_residuals(2);
  std::vector<int32_t>& sizes = *mutable_parameter_block_sizes();
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
  residual = xy - xy_;
  if (!want) return true;

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
