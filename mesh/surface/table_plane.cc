#include "mesh/surface/table_plane.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <vector>

#include "mesh/surface/vertex_normals.h"
#include "sfm_split/base/union_find.h"

namespace s2gs {
namespace {

// What looks up more than aside.
constexpr double kLevelCosine = 0.7;
// Of the rim's radius. Domes of 2 to 7 % were seen, one of 17 %; what lies lower may be a dish.
constexpr double kAbove = 0.2;
constexpr double kBelow = 0.05;
// A surface that reaches so far out, as near to the rim's height, is the table's.
constexpr double kRim = 0.9;
constexpr double kRimHeight = 0.05;

}  // namespace

std::vector<uint32_t> LevelFromRim(double height, double radius, const TriangleMesh& mesh) {
  const auto distance = [&](uint32_t v) { return static_cast<double>(mesh.vertices[v].head<2>().norm()); };
  const auto above = [&](uint32_t v) { return mesh.vertices[v].z() - height; };
  const auto is_near = [&](uint32_t v) {
    return distance(v) < radius && above(v) < kAbove * radius && above(v) > -kBelow * radius;
  };
  UnionFind connected(mesh.vertices.size());
  std::vector<bool> is_level(mesh.vertices.size(), false);
  for (const Triangle& triangle : mesh.triangles) {
    if (!is_near(triangle[0]) || !is_near(triangle[1]) || !is_near(triangle[2])) continue;
    const Eigen::Vector3f corner = mesh.vertices[triangle[0]];
    const Eigen::Vector3f normal =
        (mesh.vertices[triangle[1]] - corner).cross(mesh.vertices[triangle[2]] - corner);
    if (!(normal.z() > kLevelCosine * normal.norm())) continue;
    for (int i = 0; i < 3; ++i) {
      is_level[triangle[i]] = true;
      connected.Join(triangle[0], triangle[i]);
    }
  }
  std::vector<bool> reaches_rim(mesh.vertices.size(), false);
  for (uint32_t v = 0; v < mesh.vertices.size(); ++v) {
    if (is_level[v] && distance(v) > kRim * radius && std::abs(above(v)) < kRimHeight * radius) {
      reaches_rim[connected.Root(v)] = true;
    }
  }
  std::vector<uint32_t> level;
  for (uint32_t v = 0; v < mesh.vertices.size(); ++v) {
    if (is_level[v] && reaches_rim[connected.Root(v)]) level.push_back(v);
  }
  return level;
}

void MoveToHeight(double height, const std::vector<uint32_t>& vertices, TriangleMesh* mesh) {
  for (const uint32_t v : vertices) mesh->vertices[v].z() = static_cast<float>(height);
  ComputeNormals(mesh);
}

}  // namespace s2gs
