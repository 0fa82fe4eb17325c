#include "mesh/surface/parts_on_table.h"

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "mesh/surface/mesh_cleanup.h"
#include "sfm_split/base/union_find.h"

namespace s2gs {
namespace {

double TwiceTheArea(const TriangleMesh& mesh, const Triangle& triangle) {
  const Eigen::Vector3d a = mesh.vertices[triangle[0]].cast<double>();
  return (mesh.vertices[triangle[1]].cast<double>() - a)
      .cross(mesh.vertices[triangle[2]].cast<double>() - a)
      .norm();
}

}  // namespace

int DropSmallPartsOnTable(double height, double min_area_pct, TriangleMesh* mesh) {
  const auto is_above = [&](uint32_t v) { return mesh->vertices[v].z() > height; };
  UnionFind joined(mesh->vertices.size());
  // The corner by which each triangle belongs to a part; the number of vertices for what belongs to none.
  const auto none = static_cast<uint32_t>(mesh->vertices.size());
  std::vector<uint32_t> corners;
  corners.reserve(mesh->triangles.size());
  for (const Triangle& triangle : mesh->triangles) {
    uint32_t above = none;
    for (int i = 0; i < 3; ++i) {
      if (!is_above(triangle[i])) continue;
      if (above != none) joined.Join(above, triangle[i]);
      above = triangle[i];
    }
    corners.push_back(above);
  }
  std::vector<double> areas(mesh->vertices.size());  // by root
  for (size_t t = 0; t < corners.size(); ++t) {
    if (corners[t] != none) areas[joined.Root(corners[t])] += TwiceTheArea(*mesh, mesh->triangles[t]);
  }
  if (areas.empty()) return 0;
  const double least = *std::max_element(areas.begin(), areas.end()) * min_area_pct / 100;
  const auto is_small = [&](double area) { return area > 0 && area < least; };
  const auto count = std::count_if(areas.begin(), areas.end(), is_small);
  if (count == 0) return 0;
  std::vector<bool> keep;
  keep.reserve(corners.size());
  for (const uint32_t corner : corners)
    keep.push_back(corner == none || !is_small(areas[joined.Root(corner)]));
  KeepTriangles(keep, mesh);
  return static_cast<int>(count);
}

}  // namespace s2gs
