#pragma once

#include <Eigen/Core>
#include <cmath>

#include "s2gs/core/pinhole_view.h"
#include "tests/support/camera_towards_origin.h"

namespace s2gs {

/// What a camera 30 degrees above the level of the origin sees, which it looks at: a picture of width x
/// height pixels of a lens of this focal length [px], in a world that stands still. \param azimuth  where the
/// camera stands about the z axis [rad].
inline PinholeView ViewFromAbove(int width, int height, double focal, double azimuth, double distance) {
  PinholeView view;
  view.width = width;
  view.height = height;
  view.fx = view.fy = focal;
  view.cx = width / 2.0;
  view.cy = height / 2.0;
  const double level = std::sqrt(0.75);
  view.cam_from_world = CameraTowardsOrigin(
      distance * Eigen::Vector3d(std::cos(azimuth) * level, std::sin(azimuth) * level, 0.5));
  view.cam_from_object = view.cam_from_world;
  return view;
}

}  // namespace s2gs
