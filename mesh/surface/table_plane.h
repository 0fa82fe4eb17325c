#pragma once

#include <cstdint>
#include <vector>

#include "mesh/surface/triangle_mesh.h"

namespace s2gs {

/// The vertices of the surface that leads level from the rim of a table's top inwards, up to where it rises
/// more steeply, in ascending order. A table's top is a plane, but where it has no texture photos do not say
/// so, and training leaves a dome between the rim, whose height photos do tell, and what stands on it.
/// \param height, radius  of the rim. \param mesh  z is the axis.
std::vector<uint32_t> LevelFromRim(double height, double radius, const TriangleMesh& mesh);

/// Moves the vertices to a height along z. What stands on them hangs together with them as before. Normals
/// are computed again.
void MoveToHeight(double height, const std::vector<uint32_t>& vertices, TriangleMesh* mesh);

}  // namespace s2gs
