#pragma once

#include "mesh/surface/triangle_mesh.h"

namespace s2gs {

/// Replaces the normals by the area-weighted means of each vertex's triangles; vertices without area get
/// (0, 0, 1).
void ComputeNormals(TriangleMesh* mesh);

}  // namespace s2gs
