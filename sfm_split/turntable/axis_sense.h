#pragma once

#include <Eigen/Core>
#include <vector>

namespace s2gs {

/// +1 when the table's axis (unit, in the world's frame) points to where the cameras look down from, else -1.
/// When they look level (below 5 degrees), image tops are up. \param cam_from_world  rotations, at least one.
double AxisUpSign(const Eigen::Vector3d& axis, const std::vector<Eigen::Matrix3d>& cam_from_world);

}  // namespace s2gs
