#include "sfm_split/turntable/axis_sense.h"

#include <cmath>

#include "sfm_split/base/angles.h"

namespace s2gs {

double AxisUpSign(const Eigen::Vector3d& axis, const std::vector<Eigen::Matrix3d>& cam_from_world) {
  // Cameras nearer to the table's own height do not tell above from below.
  constexpr double kLevel = 5 * kPi / 180;
  Eigen::Vector3d view = Eigen::Vector3d::Zero();
  Eigen::Vector3d up = Eigen::Vector3d::Zero();
  for (const Eigen::Matrix3d& rotation : cam_from_world) {
    view += rotation.row(2).transpose();
    up -= rotation.row(1).transpose();
  }
  view /= static_cast<double>(cam_from_world.size());
  const double down = -axis.dot(view);
  if (std::abs(down) > std::sin(kLevel)) return down > 0 ? 1 : -1;
  return axis.dot(up) >= 0 ? 1 : -1;
}

}  // namespace s2gs
