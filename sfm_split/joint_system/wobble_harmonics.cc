#include "sfm_split/joint_system/wobble_harmonics.h"

#include <cmath>

#include "sfm_split/base/rotation.h"

namespace s2gs {

using Eigen::Vector3d;

WobbleOfPose DeviationFromTurn(const Vector3d& axis_direction, const Vector3d& axis_point,
                               const Rigid3& world_from_object) {
  WobbleOfPose wobble;
  const Eigen::Matrix3d rotation = world_from_object.rotation.toRotationMatrix();
  const Eigen::Matrix3d turn = RotationAbout<double>(axis_direction, AngleAbout(axis_direction, rotation));
  wobble.tilt_rad = LogRotation(Eigen::Matrix3d(rotation * turn.transpose()));
  wobble.shift = world_from_object * axis_point - axis_point;
  return wobble;
}

std::pair<Vector3d, Vector3d> AcrossAxis(const Vector3d& axis_direction) {
  const Vector3d across = axis_direction.unitOrthogonal();
  return {across, axis_direction.cross(across)};
}

WobbleHarmonics::Terms WobbleHarmonics::TermsAt(double angle_rad) {
  Terms terms;
  terms << 1, std::cos(angle_rad), std::sin(angle_rad), std::cos(2 * angle_rad), std::sin(2 * angle_rad);
  return terms;
}

}  // namespace s2gs
