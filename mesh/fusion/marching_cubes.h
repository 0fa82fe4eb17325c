#pragma once

#include <array>
#include <cstdint>

#include "mesh/fusion/tsdf.h"
#include "mesh/surface/triangle_mesh.h"

namespace s2gs {

/// The surface where the field is zero, between voxels that were all seen (weight > 0), in the object's
/// frame, with normals (area-weighted means of the triangles'). Counter-clockwise seen from where the field
/// is positive. Every edge belongs to two triangles, except where the field ends; order and values do not
/// depend on the number of threads.
/// Throws UserError when the mesh has more vertices than 32 bits can count.
TriangleMesh MarchingCubes(const TsdfVolume& volume, int num_threads);

/// The triangles of a cube for each set of corners that lie inside (negative). Corner c is at
/// (c & 1, c >> 1 & 1, c >> 2); edge 4 * axis + k runs along the axis from the k-th corner whose coordinate
/// on that axis is 0.
struct MarchingCubesCase {
  int num_triangles = 0;
  std::array<uint8_t, 36> edges{};  ///< three for each triangle.
};
const std::array<MarchingCubesCase, 256>& MarchingCubesTable();

/// The corner that an edge starts at; it ends at that corner + (1 << (edge / 4)).
constexpr int EdgeStart(int edge) {
  const int axis = edge / 4;
  const int k = edge % 4;
  // The two other coordinates, the lower axis first.
  const int low = axis == 0 ? 1 : 0;
  const int high = axis == 2 ? 1 : 2;
  return (k & 1) << low | (k >> 1) << high;
}

}  // namespace s2gs
