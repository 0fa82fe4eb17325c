#include "mesh/surface/mesh_cleanup.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>
#include <unordered_map>
#include <utility>

#include "mesh/surface/decimate.h"
#include "mesh/surface/support_plane.h"
#include "mesh/surface/table_top.h"
#include "mesh/surface/triangle_area.h"
#include "mesh/surface/vertex_normals.h"
#include "sfm_split/base/union_find.h"

namespace s2gs {
namespace {

// Drops vertices that no triangle uses.
void Compact(TriangleMesh* mesh) {
  constexpr uint32_t kUnused = std::numeric_limits<uint32_t>::max();
  std::vector<uint32_t> places(mesh->vertices.size(), kUnused);
  for (const Triangle& triangle : mesh->triangles) {
    for (int i = 0; i < 3; ++i) places[triangle[i]] = 0;
  }
  uint32_t count = 0;
  for (size_t i = 0; i < places.size(); ++i) {
    if (places[i] == kUnused) continue;
    mesh->vertices[count] = mesh->vertices[i];
    if (!mesh->normals.empty()) mesh->normals[count] = mesh->normals[i];
    if (!mesh->colors.empty()) mesh->colors[count] = mesh->colors[i];
    places[i] = count++;
  }
  mesh->vertices.resize(count);
  if (!mesh->normals.empty()) mesh->normals.resize(count);
  if (!mesh->colors.empty()) mesh->colors.resize(count);
  mesh->extra_vertex_properties.clear();
  for (Triangle& triangle : mesh->triangles) {
    for (int i = 0; i < 3; ++i) triangle[i] = places[triangle[i]];
  }
}

void KeepLargeClusters(double min_area_pct, const PartJudge& judge, TriangleMesh* mesh,
                       MeshCleanupSummary* summary) {
  const std::vector<int> clusters = ClusterOfTriangles(*mesh);
  summary->num_clusters = clusters.empty() ? 0 : *std::max_element(clusters.begin(), clusters.end()) + 1;
  std::vector<double> areas(summary->num_clusters);
  for (size_t t = 0; t < clusters.size(); ++t) {
    areas[clusters[t]] += TriangleArea(*mesh, mesh->triangles[t]);
  }
  if (areas.empty()) return;
  std::vector<PartSight> sights(areas.size(), PartSight::kUnknown);
  if (judge && min_area_pct > 0 && min_area_pct < 100) sights = judge(*mesh, clusters);
  const auto largest = std::max_element(areas.begin(), areas.end());
  const double least = *largest * min_area_pct / 100;
  std::vector<bool> is_kept(areas.size());
  for (size_t c = 0; c < areas.size(); ++c) {
    const bool is_large = min_area_pct < 100 ? areas[c] >= least : &areas[c] == &*largest;
    is_kept[c] = is_large ? sights[c] != PartSight::kNotThere : sights[c] == PartSight::kThere;
    if (is_kept[c] != is_large) ++(is_large ? summary->num_large_dropped : summary->num_small_kept);
  }
  std::vector<bool> keep(clusters.size());
  for (size_t t = 0; t < clusters.size(); ++t) keep[t] = is_kept[clusters[t]];
  KeepTriangles(keep, mesh);
  summary->num_clusters_kept = static_cast<int>(std::count(is_kept.begin(), is_kept.end(), true));
}

uint64_t EdgeKey(uint32_t a, uint32_t b) { return uint64_t{std::min(a, b)} << 32U | std::max(a, b); }

}  // namespace

OptionCheck MeshCleanupOptions::Check() const {
  const auto fault = [](const char* field, double value, const char* bound) {
    return OptionFault{field, fmt::format("{}", value), bound};
  };
  if (!(min_cluster_area_pct >= 0) || !(min_cluster_area_pct <= 100)) {
    return fault("min_cluster_area_pct", min_cluster_area_pct, "0 <= min_cluster_area_pct <= 100");
  }
  // The time to close a hole grows with the cube of its edges.
  if (max_hole_edges < 0 || max_hole_edges > 500) {
    return fault("max_hole_edges", max_hole_edges, "0 <= max_hole_edges <= 500");
  }
  if (smoothing_iterations < 0 || smoothing_iterations > 1000) {
    return fault("smoothing_iterations", smoothing_iterations, "0 <= smoothing_iterations <= 1000");
  }
  if (max_triangles < 0) {
    return fault("max_triangles", static_cast<double>(max_triangles), "0 <= max_triangles");
  }
  return std::nullopt;
}

MeshCleanupSummary CleanMesh(const MeshCleanupOptions& options, Reporter& reporter, TriangleMesh* mesh,
                             const PartJudge& judge) {
  MeshCleanupSummary summary;
  if (options.cut_at_table && options.is_axis_known) {
    summary.table = FindTableTop(*mesh);
    if (summary.table) summary.num_beside_table = CutAtTable(*summary.table, mesh);
  }
  if (options.remove_disc) {
    const std::optional<Eigen::Vector3d> up =
        options.is_axis_known ? std::make_optional<Eigen::Vector3d>(Eigen::Vector3d::UnitZ())
                              : FindSupportNormal(*mesh);
    const std::optional<DiscSurface> disc = up ? FindDisc(*mesh, *up) : std::nullopt;
    if (disc) {
      summary.up = *up;
      summary.cut_height = disc->CutHeight();
      CutBelow(disc->CutHeight(), mesh, *up);
    } else {
      reporter.Warn(options.is_axis_known
                        ? "the mesh has no horizontal surface that could be the table's disc: none is cut off"
                        : "the mesh has no plane that the object could stand on: none is cut off");
    }
  }
  const bool is_one_object = summary.cut_height && !options.is_axis_known;
  KeepLargeClusters(is_one_object ? 100 : options.min_cluster_area_pct, judge, mesh, &summary);
  if (options.max_hole_edges > 0) summary.num_holes_closed = CloseHoles(options.max_hole_edges, mesh);
  if (options.smoothing_iterations > 0) SmoothMesh(options.smoothing_iterations, mesh);
  if (options.max_triangles > 0) DecimateMesh(options.max_triangles, mesh);
  if (summary.num_holes_closed > 0 || options.smoothing_iterations > 0 || options.max_triangles > 0) {
    ComputeNormals(mesh);
  }
  return summary;
}

void KeepTriangles(const std::vector<bool>& keep, TriangleMesh* mesh) {
  S2GS_INVARIANT(keep.size() == mesh->triangles.size());
  size_t count = 0;
  for (size_t t = 0; t < keep.size(); ++t) {
    if (keep[t]) mesh->triangles[count++] = mesh->triangles[t];
  }
  mesh->triangles.resize(count);
  Compact(mesh);
}

std::vector<int> ClusterOfTriangles(const TriangleMesh& mesh) {
  UnionFind connected(mesh.vertices.size());
  for (const Triangle& triangle : mesh.triangles) {
    for (int i = 1; i < 3; ++i) connected.Join(triangle[0], triangle[i]);
  }
  std::vector<int> number(mesh.vertices.size(), -1);
  std::vector<int> clusters;
  clusters.reserve(mesh.triangles.size());
  int count = 0;
  for (const Triangle& triangle : mesh.triangles) {
    int& cluster = number[connected.Root(triangle[0])];
    if (cluster < 0) cluster = count++;
    clusters.push_back(cluster);
  }
  return clusters;
}

void CutBelow(double height, TriangleMesh* mesh, const Eigen::Vector3d& up) {
  const auto is_above = [&](uint32_t v) { return up.dot(mesh->vertices[v].cast<double>()) > height; };
  std::unordered_map<uint64_t, uint32_t> cuts;
  const auto cut = [&](uint32_t above, uint32_t below) {
    const auto [entry, is_new] = cuts.try_emplace(EdgeKey(above, below), mesh->vertices.size());
    if (!is_new) return entry->second;
    const Eigen::Vector3d high = mesh->vertices[above].cast<double>();
    const Eigen::Vector3d low = mesh->vertices[below].cast<double>();
    const double t = (up.dot(high) - height) / up.dot(high - low);
    mesh->vertices.emplace_back((high + t * (low - high)).cast<float>());
    if (!mesh->normals.empty()) {
      const auto share = static_cast<float>(t);
      const Eigen::Vector3f normal = (1 - share) * mesh->normals[above] + share * mesh->normals[below];
      mesh->normals.emplace_back(normal.normalized());
    }
    if (!mesh->colors.empty()) {
      const Eigen::Array3d color = (1 - t) * mesh->colors[above].cast<double>().array() +
                                   t * mesh->colors[below].cast<double>().array() + 0.5;
      mesh->colors.emplace_back(color.cast<uint8_t>().matrix());
    }
    return entry->second;
  };
  std::vector<Triangle> kept;
  kept.reserve(mesh->triangles.size());
  for (const Triangle& triangle : mesh->triangles) {
    std::array<bool, 3> above = {is_above(triangle[0]), is_above(triangle[1]), is_above(triangle[2])};
    const int count = above[0] + above[1] + above[2];
    if (count == 3) kept.push_back(triangle);
    if (count == 0 || count == 3) continue;
    // Turned so that the corner that is alone on its side comes first.
    int first = 0;
    while (above[first] != (count == 1)) ++first;
    const uint32_t a = triangle[first];
    const uint32_t b = triangle[(first + 1) % 3];
    const uint32_t c = triangle[(first + 2) % 3];
    if (count == 1) {
      const uint32_t ab = cut(a, b);
      const uint32_t ac = cut(a, c);
      kept.emplace_back(a, ab, ac);
    } else {
      const uint32_t ba = cut(b, a);
      const uint32_t ca = cut(c, a);
      kept.emplace_back(b, c, ca);
      kept.emplace_back(b, ca, ba);
    }
  }
  mesh->triangles = std::move(kept);
  Compact(mesh);
}

void SmoothMesh(int iterations, TriangleMesh* mesh) {
  // A pass that shrinks and one that grows a little more; the pass band ends at k = 1/.5 - 1/.53 = .113.
  constexpr double kShrink = 0.5;
  constexpr double kGrow = -0.53;
  const size_t count = mesh->vertices.size();
  std::unordered_map<uint64_t, int> uses;
  uses.reserve(mesh->triangles.size() * 3 / 2);
  for (const Triangle& triangle : mesh->triangles) {
    for (int i = 0; i < 3; ++i) ++uses[EdgeKey(triangle[i], triangle[(i + 1) % 3])];
  }
  std::vector<bool> is_fixed(count);
  std::vector<int> degree(count);
  for (const auto& [key, num_triangles] : uses) {
    for (const auto v : {static_cast<uint32_t>(key >> 32U), static_cast<uint32_t>(key)}) {
      ++degree[v];
      if (num_triangles != 2) is_fixed[v] = true;
    }
  }
  std::vector<Eigen::Vector3d> positions;
  positions.reserve(count);
  for (const Eigen::Vector3f& vertex : mesh->vertices) positions.push_back(vertex.cast<double>());
  std::vector<Eigen::Vector3d> sums(count);
  for (int pass = 0; pass < 2 * iterations; ++pass) {
    std::fill(sums.begin(), sums.end(), Eigen::Vector3d::Zero());
    // In the triangles' order, so that rounding does not depend on the hash table. Inner edges come twice.
    for (const Triangle& triangle : mesh->triangles) {
      for (int i = 0; i < 3; ++i) {
        sums[triangle[i]] += positions[triangle[(i + 1) % 3]] + positions[triangle[(i + 2) % 3]];
      }
    }
    const double factor = pass % 2 == 0 ? kShrink : kGrow;
    for (size_t v = 0; v < count; ++v) {
      if (is_fixed[v] || degree[v] == 0) continue;
      positions[v] += factor * (sums[v] / (2.0 * degree[v]) - positions[v]);
    }
  }
  for (size_t v = 0; v < count; ++v) mesh->vertices[v] = positions[v].cast<float>();
}

}  // namespace s2gs
