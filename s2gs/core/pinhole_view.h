#pragma once

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

}  // namespace s2gs
