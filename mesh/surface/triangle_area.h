#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "mesh/surface/triangle_mesh.h"

namespace s2gs {

/// In the square of the mesh's unit, in double precision.
inline double TriangleArea(const TriangleMesh& mesh, const Triangle& triangle) {
  const Eigen::Vector3d a = mesh.vertices[triangle[0]].cast<double>();
  const Eigen::Vector3d b = mesh.vertices[triangle[1]].cast<double>();
  const Eigen::Vector3d c = mesh.vertices[triangle[2]].cast<double>();
  return (b - a).cross(c - a).norm() / 2;
}

}  // namespace s2gs
