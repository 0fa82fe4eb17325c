#include "mesh/light/mesh_raster.h"

#include <algorithm>
#include <cmath>

namespace s2gs {
namespace {

// A pixel centre this far outside of a triangle, in barycentric coordinates, is on its edge.
constexpr double kEdgeTolerance = 1e-7;

double Cross(const Eigen::Vector3d& a, const Eigen::Vector3d& b, const Eigen::Vector3d& c) {
  return (b.x() - a.x()) * (c.y() - a.y()) - (c.x() - a.x()) * (b.y() - a.y());
}

// First and last pixel whose centre lies in [low, high].
struct PixelRange {
  PixelRange(double low, double high, int size)
      : first(static_cast<int>(std::ceil(std::max(low - 0.5, 0.0)))),
        last(static_cast<int>(std::floor(std::min(high - 0.5, size - 1.0)))) {}
  int first;
  int last;
};

}  // namespace

MeshRaster RasterizeMesh(const std::vector<Eigen::Vector3f>& vertices, const std::vector<Triangle>& triangles,
                         const ObjectView& view, bool with_triangles) {
  MeshRaster raster;
  raster.width = view.width;
  raster.height = view.height;
  const size_t num_pixels = static_cast<size_t>(view.width) * view.height;
  raster.inverse_depths.assign(num_pixels, 0);
  if (with_triangles) raster.triangles.assign(num_pixels, MeshRaster::kNone);
  const Eigen::Matrix3d rotation = view.cam_from_object.rotation.toRotationMatrix();
  // Position in the image and inverse depth of each vertex; 0: behind the camera.
  std::vector<Eigen::Vector3d> projected;
  projected.reserve(vertices.size());
  for (const Eigen::Vector3f& vertex : vertices) {
    const Eigen::Vector3d x = rotation * vertex.cast<double>() + view.cam_from_object.translation;
    if (x.z() > 0) {
      projected.emplace_back(view.fx * x.x() / x.z() + view.cx, view.fy * x.y() / x.z() + view.cy, 1 / x.z());
    } else {
      projected.emplace_back(0, 0, 0);
    }
  }
  for (size_t t = 0; t < triangles.size(); ++t) {
    const Eigen::Vector3d& a = projected[triangles[t][0]];
    const Eigen::Vector3d& b = projected[triangles[t][1]];
    const Eigen::Vector3d& c = projected[triangles[t][2]];
    if (!(a.z() > 0 && b.z() > 0 && c.z() > 0)) continue;
    const double area = Cross(a, b, c);
    if (!(std::abs(area) > std::numeric_limits<double>::min())) continue;
    const auto [min_x, max_x] = std::minmax({a.x(), b.x(), c.x()});
    const auto [min_y, max_y] = std::minmax({a.y(), b.y(), c.y()});
    if (!(max_x >= 0 && max_y >= 0 && min_x <= view.width && min_y <= view.height)) continue;
    const PixelRange columns(min_x, max_x, view.width);
    const PixelRange rows(min_y, max_y, view.height);
    for (int row = rows.first; row <= rows.last; ++row) {
      for (int column = columns.first; column <= columns.last; ++column) {
        const Eigen::Vector3d pixel(column + 0.5, row + 0.5, 0);
        const double u = Cross(pixel, b, c) / area;
        const double v = Cross(pixel, c, a) / area;
        const double w = 1 - u - v;
        if (u < -kEdgeTolerance || v < -kEdgeTolerance || w < -kEdgeTolerance) continue;
        const auto inverse_depth = static_cast<float>(u * a.z() + v * b.z() + w * c.z());
        const size_t at = static_cast<size_t>(row) * view.width + column;
        if (inverse_depth <= raster.inverse_depths[at]) continue;
        raster.inverse_depths[at] = inverse_depth;
        if (with_triangles) raster.triangles[at] = static_cast<uint32_t>(t);
      }
    }
  }
  return raster;
}

}  // namespace s2gs
