#include "plugin/report/mesh_figures.h"

#include <algorithm>
#include <cmath>

#include "mesh/refine/vertex_visibility.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/parallel_for.h"

namespace s2gs {
namespace {

constexpr int kViewSide = 512;  // [px]
constexpr double kMaxViewAngleDeg = 80;

void PutNumber(uint32_t value, int bytes, std::string* out) {
  for (int i = 0; i < bytes; ++i) *out += static_cast<char>(value >> (8 * i) & 0xffU);
}

ObjectView Shrunk(ObjectView view) {
  const int side = std::max(view.width, view.height);
  if (side <= kViewSide) return view;
  const double scale = static_cast<double>(kViewSide) / side;
  view.width = std::max(1, static_cast<int>(view.width * scale));
  view.height = std::max(1, static_cast<int>(view.height * scale));
  for (double* length : {&view.fx, &view.fy, &view.cx, &view.cy}) *length *= scale;
  return view;
}

}  // namespace

MeshFigures MeasureMesh(const TriangleMesh& mesh) {
  MeshFigures figures;
  figures.num_vertices = mesh.vertices.size();
  figures.num_triangles = mesh.triangles.size();
  if (mesh.vertices.empty()) return figures;
  figures.low = figures.high = mesh.vertices.front().cast<double>();
  for (const Eigen::Vector3f& vertex : mesh.vertices) {
    figures.low = figures.low.cwiseMin(vertex.cast<double>());
    figures.high = figures.high.cwiseMax(vertex.cast<double>());
  }
  // From the box's middle, where products of coordinates are smallest.
  const Eigen::Vector3d middle = (figures.low + figures.high) / 2;
  for (const Triangle& triangle : mesh.triangles) {
    const Eigen::Vector3d a = mesh.vertices[triangle[0]].cast<double>() - middle;
    const Eigen::Vector3d b = mesh.vertices[triangle[1]].cast<double>() - middle;
    const Eigen::Vector3d c = mesh.vertices[triangle[2]].cast<double>() - middle;
    figures.area += (b - a).cross(c - a).norm() / 2;
    figures.volume += a.dot(b.cross(c)) / 6;
  }
  const std::vector<int> clusters = ClusterOfTriangles(mesh);
  if (!clusters.empty()) {
    figures.num_clusters = static_cast<size_t>(*std::max_element(clusters.begin(), clusters.end())) + 1;
  }
  for (const MeshLoop& loop : FindHoles(mesh)) {
    MeshFigures::Hole hole{loop.size(), 0};
    for (size_t i = 0; i < loop.size(); ++i) {
      hole.length += (mesh.vertices[loop[(i + 1) % loop.size()]] - mesh.vertices[loop[i]]).norm();
    }
    figures.holes.push_back(hole);
  }
  std::stable_sort(figures.holes.begin(), figures.holes.end(),
                   [](const auto& a, const auto& b) { return a.length > b.length; });
  return figures;
}

std::vector<int> CountViewsOfVertices(const TriangleMesh& mesh, const std::vector<ObjectView>& views) {
  std::vector<int> counts(mesh.vertices.size(), 0);
  VisibilityRule rule;
  rule.min_cosine = static_cast<float>(std::cos(kMaxViewAngleDeg * kPi / 180));
  std::vector<VertexFlags> seen(views.size());
  ParallelFor(static_cast<int64_t>(views.size()), 0, [&](int64_t k) {
    const auto of_view = static_cast<size_t>(k);
    seen[of_view] = FindVisibleVertices(mesh, Shrunk(views[of_view]), rule);
  });
  for (const VertexFlags& of_view : seen) {
    for (size_t i = 0; i < counts.size(); ++i) counts[i] += of_view.Get(i) ? 1 : 0;
  }
  return counts;
}

PackedMesh PackMesh(const TriangleMesh& mesh, const std::vector<int>& views,
                    const std::vector<MeshLoop>& holes) {
  PackedMesh packed;
  if (mesh.vertices.empty()) return packed;
  Eigen::Vector3f high = mesh.vertices.front();
  packed.low = high;
  for (const Eigen::Vector3f& vertex : mesh.vertices) {
    packed.low = packed.low.cwiseMin(vertex);
    high = high.cwiseMax(vertex);
  }
  packed.size = std::max((high - packed.low).maxCoeff(), 1e-30F);
  for (const Eigen::Vector3f& vertex : mesh.vertices) {
    for (int c = 0; c < 3; ++c) {
      const float share = (vertex[c] - packed.low[c]) / packed.size;
      PutNumber(static_cast<uint32_t>(std::lround(65535 * std::clamp(share, 0.0F, 1.0F))), 2,
                &packed.positions);
    }
  }
  for (const auto& color : mesh.colors) {
    for (int c = 0; c < 3; ++c) PutNumber(color[c], 1, &packed.colors);
  }
  for (const int count : views) PutNumber(static_cast<uint32_t>(std::clamp(count, 0, 255)), 1, &packed.views);
  packed.index_bytes = mesh.vertices.size() > 65536 ? 4 : 2;
  for (const Triangle& triangle : mesh.triangles) {
    for (int c = 0; c < 3; ++c) PutNumber(triangle[c], packed.index_bytes, &packed.triangles);
  }
  for (const MeshLoop& loop : holes) {
    for (size_t i = 0; i < loop.size(); ++i) {
      PutNumber(loop[i], packed.index_bytes, &packed.holes);
      PutNumber(loop[(i + 1) % loop.size()], packed.index_bytes, &packed.holes);
    }
  }
  return packed;
}

}  // namespace s2gs
