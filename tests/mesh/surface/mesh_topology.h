#pragma once

#include <cstdint>

#include "mesh/surface/triangle_mesh.h"

namespace s2gs {

/// What a mesh's triangles and edges say of it, computed without the product's code.
struct MeshTopology {
  int64_t num_boundary_edges = 0;        ///< of one triangle.
  int64_t num_bad_edges = 0;             ///< of three triangles or more, or twice in one direction.
  int64_t num_degenerate_triangles = 0;  ///< without area.
  int64_t num_unused_vertices = 0;
  int64_t euler_characteristic = 0;  ///< vertices - edges + triangles.
  int num_components = 0;
  double area = 0;
  double volume = 0;  ///< signed: positive when closed and oriented outwards.
};
MeshTopology TopologyOf(const TriangleMesh& mesh);

}  // namespace s2gs
