#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <vector>

namespace s2gs {

/// The corners of a triangle.
using TriangleCorners = std::array<Eigen::Vector3d, 3>;

/// Distance of a point to the nearest point of a triangle, its edges and corners included. For slivers and
/// triangles without area, too: the result is always the distance to some point of the triangle up to
/// rounding, never less than the true one.
double TriangleDistance(const Eigen::Vector3d& x, const TriangleCorners& triangle);

/// Triangles in a tree of bounding boxes, to find the nearest one.
class TriangleTree {
 public:
  /// \param triangles  not empty, all finite.
  explicit TriangleTree(std::vector<TriangleCorners> triangles);

  /// Distance to the nearest triangle, exact up to rounding.
  double Distance(const Eigen::Vector3d& x) const;

 private:
  struct Node {
    Eigen::AlignedBox3d box;
    int first = 0;  ///< a leaf's first triangle; an inner node's second child, the first being the next node.
    int num_triangles = 0;  ///< triangles of a leaf; 0 in an inner node.
  };

  void Build(int begin, int end);

  std::vector<TriangleCorners> triangles_;
  std::vector<Node> nodes_;
};

/// The distance of each point to the nearest of the triangles, exact up to rounding; the same for any thread
/// count. `triangles` must not be empty and all must be finite.
std::vector<double> DistancesToTriangles(const std::vector<Eigen::Vector3d>& points,
                                         const std::vector<TriangleCorners>& triangles);

}  // namespace s2gs
