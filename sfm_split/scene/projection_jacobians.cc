#include "sfm_split/scene/projection_jacobians.h"

#include <ceres/jet.h>

#include <array>

#include "sfm_split/base/error.h"
#include "sfm_split/scene/camera_projection.h"

namespace s2gs {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
using Matrix23 = Eigen::Matrix<double, 2, 3>;

// Flatter rays than this are behind the camera, as far as numbers go.
constexpr double kMinDepthOverDistance = 1e-6;

bool ProjectRadial(bool one_focal, int num_radial, const double* params, const Vector3d& x, Vector2d* xy,
                   Matrix23* jacobian_x, IntrinsicsJacobian* jacobian_params) {
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
                   Matrix23* jacobian_x, IntrinsicsJacobian* jacobian_params) {
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
                          Matrix23* jacobian_x, IntrinsicsJacobian* jacobian_params) {
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

}  // namespace s2gs
