#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <limits>
#include <vector>

#include "mesh/surface/object_view.h"
#include "mesh/surface/triangle_mesh.h"

namespace s2gs {

/// What a view shows of a mesh at the centre of each pixel, rows from top to bottom.
struct MeshRaster {
  static constexpr uint32_t kNone = std::numeric_limits<uint32_t>::max();

  int width = 0;                         ///< [px]
  int height = 0;                        ///< [px]
  std::vector<float> inverse_depths;     ///< of the nearest surface, along the camera's z axis; 0: none.
  std::vector<uint32_t> triangles = {};  ///< the triangle, or kNone; empty unless asked for.
};

/// Exact for triangles of any size: the inverse depth of a plane is linear in the image. Triangles that reach
/// behind the camera are left out. Shows both sides of a triangle.
MeshRaster RasterizeMesh(const std::vector<Eigen::Vector3f>& vertices, const std::vector<Triangle>& triangles,
                         const ObjectView& view, bool with_triangles);

}  // namespace s2gs
