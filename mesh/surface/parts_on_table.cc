#include "mesh/surface/parts_on_table.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>

#include "mesh/surface/mesh_cleanup.h"
#include "mesh/surface/triangle_area.h"
#include "sfm_split/base/union_find.h"

namespace s2gs {

std::vector<int> PartsAbove(double height, const TriangleMesh& mesh) {
  const auto is_above = [&](uint32_t v) { return mesh.vertices[v].z() > height; };
  UnionFind joined(mesh.vertices.size());
  for (const Triangle& triangle : mesh.triangles) {
    for (int i = 0; i < 3; ++i) {
      const uint32_t next = triangle[(i + 1) % 3];
      if (is_above(triangle[i]) && is_above(next)) joined.Join(triangle[i], next);
    }
  }
  std::vector<int> number(mesh.vertices.size(), kNoPart);  // by root
  std::vector<int> parts(mesh.vertices.size(), kNoPart);
  int count = 0;
  for (uint32_t v = 0; v < parts.size(); ++v) {
    if (!is_above(v)) continue;
    int& part = number[joined.Root(v)];
    if (part == kNoPart) part = count++;
    parts[v] = part;
  }
  return parts;
}

int DropSmallPartsOnTable(double height, double min_area_pct, TriangleMesh* mesh, const PartJudge& judge) {
  const std::vector<int> parts = PartsAbove(height, *mesh);
  if (parts.empty()) return 0;
  const auto part_of = [&](const Triangle& triangle) {
    return std::max({parts[triangle[0]], parts[triangle[1]], parts[triangle[2]]});
  };
  std::vector<double> areas(*std::max_element(parts.begin(), parts.end()) + 1);
  if (areas.empty()) return 0;
  for (const Triangle& triangle : mesh->triangles) {
    if (part_of(triangle) != kNoPart) areas[part_of(triangle)] += TriangleArea(*mesh, triangle);
  }
  std::vector<PartSight> sights(areas.size(), PartSight::kUnknown);
  if (judge && min_area_pct > 0 && min_area_pct < 100) {
    std::vector<int> part_of_triangle;
    part_of_triangle.reserve(mesh->triangles.size());
    for (const Triangle& triangle : mesh->triangles) part_of_triangle.push_back(part_of(triangle));
    sights = judge(*mesh, part_of_triangle);
    sights.resize(areas.size(), PartSight::kUnknown);
  }
  const double least = *std::max_element(areas.begin(), areas.end()) * min_area_pct / 100;
  std::vector<bool> is_dropped(areas.size());
  for (size_t part = 0; part < areas.size(); ++part) {
    is_dropped[part] = areas[part] > 0 && (areas[part] < least ? sights[part] != PartSight::kThere
                                                               : sights[part] == PartSight::kNotThere);
  }
  const auto count = std::count(is_dropped.begin(), is_dropped.end(), true);
  if (count == 0) return 0;
  std::vector<bool> keep;
  keep.reserve(mesh->triangles.size());
  for (const Triangle& triangle : mesh->triangles)
    keep.push_back(part_of(triangle) == kNoPart || !is_dropped[part_of(triangle)]);
  KeepTriangles(keep, mesh);
  return static_cast<int>(count);
}

}  // namespace s2gs
