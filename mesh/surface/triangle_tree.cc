#include "mesh/surface/triangle_tree.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "sfm_split/base/error.h"
#include "sfm_split/base/parallel_for.h"

namespace s2gs {
namespace {

using Eigen::AlignedBox3d;
using Eigen::Vector3d;

// Triangles of a leaf: a box costs about as much to test as a quarter of a triangle.
constexpr int kMaxLeafSize = 4;

double SquaredSegmentDistance(const Vector3d& x, const Vector3d& a, const Vector3d& b) {
  const Vector3d along = b - a;
  const double squared_length = along.squaredNorm();
  const double t = squared_length > 0 ? std::clamp((x - a).dot(along) / squared_length, 0.0, 1.0) : 0.0;
  return (x - a - t * along).squaredNorm();
}

double SquaredTriangleDistance(const Vector3d& x, const TriangleCorners& triangle) {
  const auto& [a, b, c] = triangle;
  double best = std::min(
      {SquaredSegmentDistance(x, a, b), SquaredSegmentDistance(x, b, c), SquaredSegmentDistance(x, c, a)});
  // The foot on the plane, where it lies inside, by its barycentric coordinates. Rounding may put it aside,
  // but not out of the triangle, so that it is never nearer than the triangle is.
  const Vector3d ab = b - a, ac = c - a, ax = x - a;
  const Vector3d normal = ab.cross(ac);
  const double squared_normal = normal.squaredNorm();
  if (squared_normal > 0) {
    const double v = ax.cross(ac).dot(normal) / squared_normal;
    const double w = ab.cross(ax).dot(normal) / squared_normal;
    if (v >= 0 && w >= 0 && v + w <= 1) best = std::min(best, (ax - v * ab - w * ac).squaredNorm());
  }
  return best;
}

Vector3d TwiceCentre(const TriangleCorners& triangle) {
  return triangle[0].cwiseMin(triangle[1]).cwiseMin(triangle[2]) +
         triangle[0].cwiseMax(triangle[1]).cwiseMax(triangle[2]);
}

}  // namespace

double TriangleDistance(const Vector3d& x, const TriangleCorners& triangle) {
  return std::sqrt(SquaredTriangleDistance(x, triangle));
}

TriangleTree::TriangleTree(std::vector<TriangleCorners> triangles) : triangles_(std::move(triangles)) {
  S2GS_INVARIANT(!triangles_.empty());
  nodes_.reserve(triangles_.size());
  Build(0, static_cast<int>(triangles_.size()));
}

void TriangleTree::Build(int begin, int end) {
  const size_t node = nodes_.size();
  nodes_.emplace_back();
  AlignedBox3d box, centres;
  for (int i = begin; i < end; ++i) {
    for (const Vector3d& corner : triangles_[i]) box.extend(corner);
    centres.extend(TwiceCentre(triangles_[i]));
  }
  nodes_[node].box = box;
  if (end - begin <= kMaxLeafSize) {
    nodes_[node].first = begin;
    nodes_[node].num_triangles = end - begin;
    return;
  }
  int axis = 0;
  centres.sizes().maxCoeff(&axis);
  const int middle = begin + (end - begin) / 2;
  std::nth_element(triangles_.begin() + begin, triangles_.begin() + middle, triangles_.begin() + end,
                   [axis](const TriangleCorners& a, const TriangleCorners& b) {
                     return TwiceCentre(a)[axis] < TwiceCentre(b)[axis];
                   });
  Build(begin, middle);
  nodes_[node].first = static_cast<int>(nodes_.size());
  Build(middle, end);
}

double TriangleTree::Distance(const Vector3d& x) const {
  // Each level leaves at most one node behind, and halving 2^31 triangles takes 31 levels.
  std::array<std::pair<double, int>, 64> stack;
  size_t size = 0;
  stack[size++] = {nodes_[0].box.squaredExteriorDistance(x), 0};
  double best = std::numeric_limits<double>::infinity();
  while (size > 0) {
    const auto [bound, index] = stack[--size];
    if (!(bound < best)) continue;
    const Node& node = nodes_[index];
    for (int i = node.first; i < node.first + node.num_triangles; ++i) {
      best = std::min(best, SquaredTriangleDistance(x, triangles_[i]));
    }
    if (node.num_triangles > 0) continue;
    std::pair<double, int> near{nodes_[index + 1].box.squaredExteriorDistance(x), index + 1};
    std::pair<double, int> far{nodes_[node.first].box.squaredExteriorDistance(x), node.first};
    if (far.first < near.first) std::swap(near, far);
    stack[size++] = far;
    stack[size++] = near;
  }
  return std::sqrt(best);
}

std::vector<double> DistancesToTriangles(const std::vector<Vector3d>& points,
                                         const std::vector<TriangleCorners>& triangles) {
  const TriangleTree tree(triangles);
  std::vector<double> distances(points.size());
  ParallelFor(static_cast<int64_t>(points.size()), 0, 256,
              [&](int64_t i) { distances[i] = tree.Distance(points[i]); });
  return distances;
}

}  // namespace s2gs
