#pragma once

#include <cstdint>

#include "mesh/surface/triangle_mesh.h"

namespace s2gs {

/// Collapses edges, those first whose loss changes the surface least (Garland and Heckbert, "Surface
/// simplification using quadric error metrics", SIGGRAPH 1997), until at most `max_triangles` are left or no
/// edge can go without turning a triangle over or changing the topology. Holes keep their outlines. Colours
/// are blended; normals and extra properties are dropped.
void DecimateMesh(int64_t max_triangles, TriangleMesh* mesh);

/// The same until no edge can go without a vertex lying further than `max_error` [as the vertices], in the
/// root mean square weighted by area, from the planes of the triangles that it came to stand for. Flat parts
/// keep few triangles, edges and details theirs. Nothing happens when `max_error` is 0.
void SimplifyMesh(double max_error, TriangleMesh* mesh);

}  // namespace s2gs
