#pragma once

#include <Eigen/Core>

#include "sfm_split/circular_motion/circular_likelihood.h"

namespace s2gs {

/// A keypoint as a ray with z = 1, and how that moves with the lens.
struct LensPoint {
  bool is_valid = false;
  Eigen::Vector3d ray = Eigen::Vector3d::UnitZ();
  Eigen::Vector3d by_log_focal = Eigen::Vector3d::Zero();
  Eigen::Vector3d by_distortion = Eigen::Vector3d::Zero();
  double px = 1;  ///< pixels per unit in the plane z = 1, here.
};

/// \param focal  of the lens [px]. \param xy  about the principal point [px].
LensPoint ThroughLens(const CircularLens& lens, double focal, const Eigen::Vector2d& xy);

}  // namespace s2gs
