#pragma once

#include <Eigen/Core>
#include <array>
#include <cmath>

namespace s2gs {

// How cameras see a table: where searches for its axis begin.

/// Elevations from which cameras look down [degrees], close enough that a refinement comes from one to the
/// next.
inline constexpr std::array<double, 10> kElevationsDeg = {3, 10, 18, 26, 34, 42, 50, 58, 68, 80};

/// Where the axis points in the picture: photos are upright, on either side, or on their head.
inline std::array<Eigen::Vector2d, 4> UpDirections() {
  return {Eigen::Vector2d(0, -1), Eigen::Vector2d(1, 0), Eigen::Vector2d(-1, 0), Eigen::Vector2d(0, 1)};
}

/// The axis, up, in the frame of a camera that looks down at the table.
/// \param up  of unit length, in the picture.
inline Eigen::Vector3d AxisInCamera(const Eigen::Vector2d& up, double elevation_rad) {
  Eigen::Vector3d axis;
  axis << std::cos(elevation_rad) * up, -std::sin(elevation_rad);
  return axis;
}

}  // namespace s2gs
