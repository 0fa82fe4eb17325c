#pragma once

#include <Eigen/Core>
#include <array>

#include "sfm_split/scene/scene.h"

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

/// The lower end of the rotating part's side, where plain surfaces look the same whether they turn or stand
/// still.
struct RotatingSide {
  RotatingRegion region;
  double inner_radius = 0;
  std::array<float, 3> color = {0, 0, 0};  ///< of the side above, [0, 1].
  float color_tolerance = 0;               ///< mean over the channels.
};

}  // namespace s2gs
