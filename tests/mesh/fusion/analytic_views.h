#pragma once

#include <Eigen/Core>
#include <vector>

#include "mesh/fusion/depth_view.h"
#include "tests/support/synthetic_shapes.h"

namespace s2gs {

struct AnalyticViewOptions {
  int num_views = 40;  ///< evenly from all sides.
  int width = 160;     ///< [px]
  int height = 140;
  double focal = 300;  ///< [px]
  Eigen::Vector2d principal_point = {83.3, 68.1};
  double ring_elevation_deg = -1;  ///< from 0 on: all views from this height over the horizon instead.
  double distance = 4;             ///< of the cameras from the middle.
  Eigen::Vector3d middle = Eigen::Vector3d::Zero();
  double scale = 1;  ///< of all lengths, after everything else.
  Eigen::Vector2d first_position = {0.5, 0.5};
  bool with_normals = false;
  bool with_colors = false;  ///< 128 + 100 n in the object's frame.
  bool with_mask = false;
};

/// Exact depth maps of shapes in the object's frame.
std::vector<DepthView> AnalyticViews(const std::vector<Shape>& shapes, const AnalyticViewOptions& options);

/// Colour of a surface point with that unit normal.
Eigen::Array3d AnalyticColor(const Eigen::Vector3d& normal);

Shape SphereShape(double radius);
Shape BoxShape(const Eigen::Vector3d& half_edges, const Rigid3& object_from_box = {});

}  // namespace s2gs
