#pragma once

#include <Eigen/Core>
#include <vector>

#include "mesh/surface/triangle_mesh.h"

namespace s2gs {

struct SurfacePlace {
  Eigen::Vector3f x;
  Eigen::Vector3f normal;  ///< of the smooth surface, of unit length.
  double area = 0;         ///< of the surface that it stands for.
};

/// About `count` places spread evenly over the surface's area, always the same: for comparing what photos
/// show of them. None when no triangle has area. \param mesh  with normals.
std::vector<SurfacePlace> PlacesOnSurface(const TriangleMesh& mesh, int count);

}  // namespace s2gs
