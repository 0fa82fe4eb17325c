#include "tests/mesh/surface/mesh_topology.h"

#include <Eigen/Geometry>
#include <map>
#include <numeric>
#include <utility>
#include <vector>

namespace s2gs {

MeshTopology TopologyOf(const TriangleMesh& mesh) {
  MeshTopology result;
  std::map<std::pair<uint32_t, uint32_t>, std::pair<int, int>> edges;  // forward and backward uses
  std::vector<uint32_t> parent(mesh.vertices.size());
  std::iota(parent.begin(), parent.end(), 0U);
  std::vector<bool> used(mesh.vertices.size());
  const auto root = [&](uint32_t v) {
    while (parent[v] != v) v = parent[v] = parent[parent[v]];
    return v;
  };
  for (const auto& triangle : mesh.triangles) {
    const Eigen::Vector3d a = mesh.vertices[triangle[0]].cast<double>();
    const Eigen::Vector3d b = mesh.vertices[triangle[1]].cast<double>();
    const Eigen::Vector3d c = mesh.vertices[triangle[2]].cast<double>();
    const double area = (b - a).cross(c - a).norm() / 2;
    result.area += area;
    result.volume += a.dot(b.cross(c)) / 6;
    if (!(area > 0)) ++result.num_degenerate_triangles;
    for (int i = 0; i < 3; ++i) {
      const uint32_t v = triangle[i];
      const uint32_t w = triangle[(i + 1) % 3];
      used[v] = true;
      auto& uses = edges[{std::min(v, w), std::max(v, w)}];
      ++(v < w ? uses.first : uses.second);
      parent[root(v)] = root(w);
    }
  }
  for (const auto& [edge, uses] : edges) {
    const auto& [forward, backward] = uses;
    if (forward > 1 || backward > 1) {
      ++result.num_bad_edges;
    } else if (forward + backward == 1) {
      ++result.num_boundary_edges;
    }
  }
  int64_t num_used = 0;
  for (uint32_t v = 0; v < used.size(); ++v) {
    if (!used[v]) continue;
    ++num_used;
    if (root(v) == v) ++result.num_components;
  }
  result.num_unused_vertices = static_cast<int64_t>(used.size()) - num_used;
  result.euler_characteristic =
      num_used - static_cast<int64_t>(edges.size()) + static_cast<int64_t>(mesh.triangles.size());
  return result;
}

}  // namespace s2gs
