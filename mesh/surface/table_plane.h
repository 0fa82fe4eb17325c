#pragma once

#include <cstdint>
#include <vector>

#include "mesh/surface/triangle_mesh.h"

namespace s2gs {

/// The plane of a table's top, across z.
struct TablePlane {
  double height = 0;
  double radius = 0;     ///< of its rim, about z.
  double seen_from = 0;  ///< height of the lowest camera.
};

/// The vertices of the surface that leads level from the rim of a table's top inwards, up to where it rises
/// more steeply, in ascending order. A table's top is a plane, but where it has no texture photos do not say
/// so, and training leaves a dome between the rim, whose height photos do tell, and what stands on it.
/// \param mesh  z is the axis.
std::vector<uint32_t> LevelFromRim(const TablePlane& plane, const TriangleMesh& mesh);

/// The vertices of what hangs on the top's plane, after those of LevelFromRim were moved there, and is no
/// body that stands on it: steps that the top had. A body shows from above, less what it shows from below,
/// the area on which it stands, whatever its shape, or at least it has a level top; a step has neither. What
/// is higher than the lowest camera stays: its top may be missing.
/// \param level  LevelFromRim's, in ascending order.
std::vector<uint32_t> StepsOnPlane(const TablePlane& plane, const std::vector<uint32_t>& level,
                                   const TriangleMesh& mesh);

/// Moves the vertices to a height along z. What stands on them hangs together with them as before. Normals
/// are computed again.
void MoveToHeight(double height, const std::vector<uint32_t>& vertices, TriangleMesh* mesh);

}  // namespace s2gs
