#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace s2gs {

/// What one image says of the turntable, in the terms of equations (1) to (3) of turntable.h.
struct TurntableMeasurement {
  Eigen::Matrix3d a;            ///< A_t.
  Eigen::Vector3d from_object;  ///< A_t c_o(t): times lambda, the camera's place from the object's origin.
  Eigen::Vector3d centre;       ///< C_b(t).
  int station;
};

/// Residuals below are rounding, relative to lengths of 1.
inline constexpr double kRoundingFloor = 1e-13;

/// Right-handed orthonormal columns (b1, b2, axis) for a unit vector `axis`.
inline Eigen::Matrix3d BasisWithThirdAxis(const Eigen::Vector3d& axis) {
  Eigen::Matrix3d basis;
  basis.col(2) = axis;
  basis.col(0) = axis.unitOrthogonal();
  basis.col(1) = axis.cross(basis.col(0));
  return basis;
}

}  // namespace s2gs
