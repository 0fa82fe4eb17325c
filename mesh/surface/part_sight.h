#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "mesh/surface/triangle_mesh.h"

namespace s2gs {

/// What photos say of a part of a mesh.
enum class PartSight : uint8_t { kUnknown, kThere, kNotThere };

/// Asks photos about the parts of a mesh. \param part_of_triangle  of each triangle, numbered from 0; below
/// 0: of no part, not judged. \return  by part.
using PartJudge =
    std::function<std::vector<PartSight>(const TriangleMesh& mesh, const std::vector<int>& part_of_triangle)>;

}  // namespace s2gs
