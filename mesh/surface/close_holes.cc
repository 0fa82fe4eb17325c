#include <Eigen/Geometry>
#include <algorithm>
#include <limits>
#include <unordered_map>
#include <unordered_set>
#include <utility>
#include <vector>

#include "mesh/surface/mesh_cleanup.h"

namespace s2gs {
namespace {

using Loop = MeshLoop;

uint64_t Directed(uint32_t from, uint32_t to) { return uint64_t{from} << 32U | to; }

std::unordered_set<uint64_t> DirectedEdges(const TriangleMesh& mesh) {
  std::unordered_set<uint64_t> edges;
  edges.reserve(3 * mesh.triangles.size());
  for (const Triangle& triangle : mesh.triangles) {
    for (int i = 0; i < 3; ++i) edges.insert(Directed(triangle[i], triangle[(i + 1) % 3]));
  }
  return edges;
}

std::vector<Loop> HoleLoops(const TriangleMesh& mesh, const std::unordered_set<uint64_t>& edges) {
  std::vector<std::pair<uint32_t, uint32_t>> border;
  for (const Triangle& triangle : mesh.triangles) {
    for (int i = 0; i < 3; ++i) {
      const uint32_t from = triangle[i];
      const uint32_t to = triangle[(i + 1) % 3];
      if (edges.count(Directed(to, from)) == 0) border.emplace_back(from, to);
    }
  }
  std::sort(border.begin(), border.end());
  std::vector<bool> is_used(border.size());
  // The first edge from a vertex that is not used yet.
  const auto next_edge = [&](uint32_t from) {
    auto edge = std::lower_bound(border.begin(), border.end(), std::make_pair(from, 0U));
    while (edge != border.end() && edge->first == from && is_used[edge - border.begin()]) ++edge;
    return edge != border.end() && edge->first == from ? edge - border.begin() : std::ptrdiff_t{-1};
  };
  std::vector<Loop> loops;
  for (size_t first = 0; first < border.size(); ++first) {
    if (is_used[first]) continue;
    Loop path = {border[first].first};
    std::unordered_map<uint32_t, size_t> place = {{border[first].first, 0}};
    for (auto edge = static_cast<std::ptrdiff_t>(first); edge >= 0; edge = next_edge(path.back())) {
      is_used[edge] = true;
      const uint32_t vertex = border[edge].second;
      const auto met = place.find(vertex);
      if (met == place.end()) {
        place.emplace(vertex, path.size());
        path.push_back(vertex);
        continue;
      }
      // Where holes touch in a vertex, each becomes a loop of its own.
      const auto begin = path.begin() + static_cast<std::ptrdiff_t>(met->second);
      loops.emplace_back(begin, path.end());
      for (auto v = begin + 1; v != path.end(); ++v) place.erase(*v);
      path.erase(begin + 1, path.end());
    }
  }
  return loops;
}

// Dynamic programming over the stretches of the loop. Returns no triangles when every way would use an edge
// that the mesh has already.
std::vector<Triangle> FillLoop(const Loop& loop, const TriangleMesh& mesh,
                               const std::unordered_set<uint64_t>& edges) {
  const auto n = static_cast<int>(loop.size());
  constexpr double kImpossible = std::numeric_limits<double>::infinity();
  std::vector<double> best(static_cast<size_t>(n) * n, 0);
  std::vector<int> split(static_cast<size_t>(n) * n, -1);
  const auto at = [n](int i, int j) { return static_cast<size_t>(i) * n + j; };
  std::vector<Eigen::Vector3d> points;
  points.reserve(loop.size());
  for (const uint32_t v : loop) points.push_back(mesh.vertices[v].cast<double>());
  for (int length = 2; length < n; ++length) {
    for (int i = 0; i + length < n; ++i) {
      const int j = i + length;
      double& least = best[at(i, j)];
      least = kImpossible;
      const bool is_whole = i == 0 && j == n - 1;
      if (!is_whole &&
          (edges.count(Directed(loop[i], loop[j])) != 0 || edges.count(Directed(loop[j], loop[i])) != 0)) {
        continue;
      }
      for (int k = i + 1; k < j; ++k) {
        const double area = (points[k] - points[i]).cross(points[j] - points[i]).norm();
        const double sum = best[at(i, k)] + best[at(k, j)] + area;
        if (sum < least) {
          least = sum;
          split[at(i, j)] = k;
        }
      }
    }
  }
  std::vector<Triangle> triangles;
  if (best[at(0, n - 1)] == kImpossible) return triangles;
  std::vector<std::pair<int, int>> open = {{0, n - 1}};
  while (!open.empty()) {
    const auto [i, j] = open.back();
    open.pop_back();
    if (j - i < 2) continue;
    const int k = split[at(i, j)];
    // Against the direction of the border, so that both sides of its edges agree.
    triangles.emplace_back(loop[j], loop[k], loop[i]);
    open.emplace_back(i, k);
    open.emplace_back(k, j);
  }
  return triangles;
}

}  // namespace

std::vector<MeshLoop> FindHoles(const TriangleMesh& mesh) { return HoleLoops(mesh, DirectedEdges(mesh)); }

int CloseHoles(int max_edges, TriangleMesh* mesh) {
  std::unordered_set<uint64_t> edges = DirectedEdges(*mesh);
  int count = 0;
  for (const Loop& loop : HoleLoops(*mesh, edges)) {
    if (loop.size() < 3 || loop.size() > static_cast<size_t>(max_edges)) continue;
    const std::vector<Triangle> filling = FillLoop(loop, *mesh, edges);
    if (filling.empty()) continue;
    for (const Triangle& triangle : filling) {
      mesh->triangles.push_back(triangle);
      for (int i = 0; i < 3; ++i) edges.insert(Directed(triangle[i], triangle[(i + 1) % 3]));
    }
    ++count;
  }
  return count;
}

}  // namespace s2gs
