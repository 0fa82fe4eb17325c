#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "mesh/surface/triangle_mesh.h"

namespace s2gs {

struct SurfacePlace {
  Eigen::Vector3f x;
  Eigen::Vector3f normal;  ///< of the smooth surface, of unit length.
  double area = 0;         ///< of the surface that it stands for.
  uint32_t triangle = 0;   ///< in which it lies, at these barycentric coordinates of its first two corners.
  float u = 0;
  float v = 0;
};

/// About `count` places spread evenly over the surface's area, always the same: for comparing what photos
/// show of them. None when no triangle has area. \param mesh  with normals.
std::vector<SurfacePlace> PlacesOnSurface(const TriangleMesh& mesh, int count);

}  // namespace s2gs
