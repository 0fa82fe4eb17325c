#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "mesh/surface/triangle_mesh.h"

namespace s2gs {

struct ChartOptions {
  double texel_size = 0;  ///< edge of a texel on a surface that faces the chart, in the mesh's unit.
  int gutter = 4;         ///< texels around the chart that belong to it [px].
  int max_side = 8192;    ///< of a chart with its gutter [px].
};

/// A connected piece of the mesh that is seen whole, without folds, along one direction: its texels are its
/// parallel projection along that direction.
struct Chart {
  std::vector<uint32_t> triangles;
  Eigen::Vector3f right = Eigen::Vector3f::UnitX();  ///< along a row of texels, of unit length.
  Eigen::Vector3f down = Eigen::Vector3f::UnitY();   ///< from row to row, of unit length.
  Eigen::Vector2f origin = Eigen::Vector2f::Zero();  ///< of the picture's corner, along both.
  float texel_size = 1;                              ///< in the mesh's unit.
  int width = 0;                                     ///< with the gutter [px].
  int height = 0;                                    ///< the same.

  /// Position of a point in the chart's picture [px].
  Eigen::Vector2f Project(const Eigen::Vector3f& x) const {
    return (Eigen::Vector2f(right.dot(x), down.dot(x)) - origin) / texel_size;
  }
};

/// Cuts the mesh into charts: regions that grow from the flattest places for as long as the smoothed surface
/// turns away from the place's normal by no more than 45 degrees, so that no direction on the surface is
/// sampled coarser than 1.4 texels unless it is rougher than its surroundings. Triangles that would lie over
/// others of their chart begin a new one, unless these are within four texels on the surface. Every triangle
/// with three different corners is in one chart. \param mesh  with normals.
std::vector<Chart> MakeCharts(const TriangleMesh& mesh, const ChartOptions& options);

}  // namespace s2gs
