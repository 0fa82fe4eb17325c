#pragma once

#include <Eigen/Core>
#include <optional>

#include "sfm_split/base/rigid3.h"

namespace s2gs {

/// A pinhole view of the scene, in COLMAP's pixel convention.
struct PinholeView {
  int width = 0;                          ///< [px]
  int height = 0;                         ///< [px]
  double fx = 0, fy = 0, cx = 0, cy = 0;  ///< [px]
  Rigid3 cam_from_world;
  Rigid3 cam_from_object;    ///< cam_from_world * F_t; equal to cam_from_world in a scene without a table.
  double near_depth = 0.01;  ///< nothing nearer is drawn [scene units]; the unit of the distortion loss.
};

/// Where a view sees a point, inside of the picture or not [px]; nothing before its near plane.
inline std::optional<Eigen::Vector2d> PixelOf(const PinholeView& view, const Eigen::Vector3d& x_in_cam) {
  if (!(x_in_cam.z() > view.near_depth)) return std::nullopt;
  return Eigen::Vector2d(view.cx + view.fx * x_in_cam.x() / x_in_cam.z(),
                         view.cy + view.fy * x_in_cam.y() / x_in_cam.z());
}

}  // namespace s2gs
