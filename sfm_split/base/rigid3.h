#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace s2gs {

/// A rigid transform `b_from_a`: x_in_b = rotation * x_in_a + translation.
struct Rigid3 {
  Eigen::Quaterniond rotation = Eigen::Quaterniond::Identity();  ///< of unit length.
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();

  Eigen::Matrix4d Matrix() const {
    Eigen::Matrix4d m = Eigen::Matrix4d::Identity();
    m.topLeftCorner<3, 3>() = rotation.toRotationMatrix();
    m.topRightCorner<3, 1>() = translation;
    return m;
  }
  Rigid3 Inverse() const {
    const Eigen::Quaterniond inverse = rotation.conjugate();
    return {inverse, -(inverse * translation)};
  }
};

/// c_from_a = c_from_b * b_from_a.
inline Rigid3 operator*(const Rigid3& c_from_b, const Rigid3& b_from_a) {
  return {(c_from_b.rotation * b_from_a.rotation).normalized(),
          c_from_b.rotation * b_from_a.translation + c_from_b.translation};
}
inline Eigen::Vector3d operator*(const Rigid3& b_from_a, const Eigen::Vector3d& x_in_a) {
  return b_from_a.rotation * x_in_a + b_from_a.translation;
}

/// Where a camera stands: the projection centre in the frame that `cam_from_frame` comes from.
inline Eigen::Vector3d CameraCentre(const Rigid3& cam_from_frame) {
  return -(cam_from_frame.rotation.conjugate() * cam_from_frame.translation);
}

/// A similarity `b_from_a`: x_in_b = scale * rotation * x_in_a + translation.
struct Sim3 {
  double scale = 1;
  Eigen::Quaterniond rotation = Eigen::Quaterniond::Identity();  ///< of unit length.
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();

  Sim3 Inverse() const {
    const Eigen::Quaterniond inverse = rotation.conjugate();
    return {1 / scale, inverse, -(inverse * translation) / scale};
  }
};

inline Eigen::Vector3d operator*(const Sim3& b_from_a, const Eigen::Vector3d& x_in_a) {
  return b_from_a.scale * (b_from_a.rotation * x_in_a) + b_from_a.translation;
}

}  // namespace s2gs
