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
// Of the area of what is low: of a ball that touches the plane a fifth is level and faces up, of a steep cone
// more stands on it; of steps less.
constexpr double kOwnTop = 0.05;

// What hangs together beside the vertices that lie on the plane.
struct Hanging {
  double area = 0;
  double level = 0;
  double upwards = 0;  // the area that it shows from above, less that from below
  bool touches_plane = false;
  bool is_low = true;
  bool is_over_table = true;
  bool IsStep() const {
    return touches_plane && is_low && is_over_table && upwards < kOwnTop * area && level < kOwnTop * area;
  }
};

}  // namespace

std::vector<uint32_t> LevelFromRim(const TablePlane& plane, const TriangleMesh& mesh) {
  const double height = plane.height;
  const double radius = plane.radius;
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

std::vector<uint32_t> StepsOnPlane(const TablePlane& plane, const std::vector<uint32_t>& level,
                                   const TriangleMesh& mesh) {
  std::vector<bool> is_on_plane(mesh.vertices.size(), false);
  for (const uint32_t v : level) is_on_plane[v] = true;
  UnionFind connected(mesh.vertices.size());
  for (const Triangle& triangle : mesh.triangles) {
    for (int i = 0; i < 3; ++i) {
      const uint32_t a = triangle[i];
      const uint32_t b = triangle[(i + 1) % 3];
      if (!is_on_plane[a] && !is_on_plane[b]) connected.Join(a, b);
    }
  }
  std::vector<Hanging> parts(mesh.vertices.size());  // at their roots
  for (uint32_t v = 0; v < mesh.vertices.size(); ++v) {
    Hanging& part = parts[connected.Root(v)];
    const double above = mesh.vertices[v].z() - plane.height;
    part.is_low = part.is_low && mesh.vertices[v].z() < plane.seen_from;
    part.is_over_table = part.is_over_table && above > -kBelow * plane.radius &&
                         mesh.vertices[v].head<2>().norm() < plane.radius;
  }
  for (const Triangle& triangle : mesh.triangles) {
    const auto beside =
        std::find_if(triangle.begin(), triangle.end(), [&](uint32_t v) { return !is_on_plane[v]; });
    if (beside == triangle.end()) continue;
    const Eigen::Vector3d corner = mesh.vertices[triangle[0]].cast<double>();
    const Eigen::Vector3d normal = (mesh.vertices[triangle[1]].cast<double>() - corner)
                                       .cross(mesh.vertices[triangle[2]].cast<double>() - corner);
    Hanging& part = parts[connected.Root(*beside)];
    part.area += normal.norm();
    part.upwards += normal.z();
    if (normal.z() > kLevelCosine * normal.norm()) part.level += normal.norm();
    part.touches_plane = part.touches_plane || std::any_of(triangle.begin(), triangle.end(),
                                                           [&](uint32_t v) { return is_on_plane[v]; });
  }
  std::vector<uint32_t> steps;
  for (uint32_t v = 0; v < mesh.vertices.size(); ++v) {
    if (!is_on_plane[v] && parts[connected.Root(v)].IsStep()) steps.push_back(v);
  }
  return steps;
}

void MoveToHeight(double height, const std::vector<uint32_t>& vertices, TriangleMesh* mesh) {
  for (const uint32_t v : vertices) mesh->vertices[v].z() = static_cast<float>(height);
  ComputeNormals(mesh);
}

}  // namespace s2gs
