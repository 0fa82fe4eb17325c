#pragma once

#include "mesh/surface/triangle_mesh.h"

namespace s2gs {

/// Drops small parts that a table's top alone joins to the rest of the mesh: scraps of surface over the top,
/// which clusters of the whole mesh do not tell from what stands there. Parts are what is higher than
/// `height` along z and hangs together there; triangles that reach down to the top go with them. \param
/// height  a little above the top: what lies lower belongs to the table. \param min_area_pct  of the largest
/// part's area that a part must have to stay; 100 keeps the largest alone. \return  how many parts were
/// dropped.
int DropSmallPartsOnTable(double height, double min_area_pct, TriangleMesh* mesh);

}  // namespace s2gs
