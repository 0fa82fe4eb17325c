#pragma once

#include <vector>

#include "mesh/surface/part_sight.h"
#include "mesh/surface/triangle_mesh.h"

namespace s2gs {

constexpr int kNoPart = -1;

/// What is higher than a table's top, in parts that hang together there: the part of each vertex, numbered
/// from 0 in the order of their first vertices; kNoPart for what is no higher. \param height  along z, a
/// little above the top: what lies lower belongs to the table.
std::vector<int> PartsAbove(double height, const TriangleMesh& mesh);

/// Drops small parts that a table's top alone joins to the rest of the mesh: scraps of surface over the top,
/// which clusters of the whole mesh do not tell from what stands there. Triangles that reach down to the top
/// go with them. \param height  as in PartsAbove. \param min_area_pct  of the largest part's area that one
/// must have to stay; 100 keeps the largest alone. \param judge  as in CleanMesh. \return  how many parts
/// were dropped.
int DropSmallPartsOnTable(double height, double min_area_pct, TriangleMesh* mesh,
                          const PartJudge& judge = nullptr);

}  // namespace s2gs
