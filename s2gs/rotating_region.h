#pragma once

#include <Eigen/Core>

#include "sfm_split/scene.h"

namespace s2gs {

/// The region that the rotating part sweeps: a cylinder about the axis. It is the same in the world's and in
/// the object's frame. In the scene's lengths.
struct RotatingRegion {
  TurntableAxis axis;
  double radius = 0;
  double low = 0, high = 0;  ///< along the axis from its point.

  /// \param margin  beyond the region that is still inside.
  bool Contains(const Eigen::Vector3d& x_in_object, double margin) const;
};

}  // namespace s2gs
