#pragma once

#include <Eigen/Geometry>

#include "sfm_split/base/rigid3.h"

namespace s2gs {

/// The pose of an upright camera that looks at the origin, z being up.
/// \param center  where it stands, not on the z axis.
inline Rigid3 CameraTowardsOrigin(const Eigen::Vector3d& center) {
  Eigen::Matrix3d rotation;
  rotation.row(2) = -center.normalized();
  rotation.row(0) = Eigen::Vector3d::UnitZ().cross(center).normalized();
  rotation.row(1) = rotation.row(2).cross(rotation.row(0));
  return {Eigen::Quaterniond(rotation), -(rotation * center)};
}

}  // namespace s2gs
