#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <vector>

#include "mesh/io/glb_builder.h"
#include "mesh/surface/triangle_mesh.h"

namespace s2gs {

/// Parts of a glTF mesh, added to a primitive. What they are given must outlive GlbBuilder::Write.

/// \param vertices  at least one.
void AddGlbPositions(const std::vector<Eigen::Vector3f>& vertices, GlbBuilder* glb,
                     nlohmann::json* primitive);

/// Made of unit length, which the format demands.
void AddGlbNormals(const std::vector<Eigen::Vector3f>& normals, GlbBuilder* glb, nlohmann::json* primitive);

void AddGlbTriangles(const Triangle* triangles, uint64_t count, GlbBuilder* glb, nlohmann::json* primitive);

}  // namespace s2gs
