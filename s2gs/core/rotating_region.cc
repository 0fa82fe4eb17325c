#include "s2gs/core/rotating_region.h"

namespace s2gs {

bool RotatingRegion::Contains(const Eigen::Vector3d& x_in_object, double margin) const {
  const Eigen::Vector3d from_axis = x_in_object - axis.point;
  const double height = from_axis.dot(axis.direction);
  return height >= low - margin && height <= high + margin &&
         (from_axis - height * axis.direction).norm() <= radius + margin;
}

}  // namespace s2gs
