#include "mesh/texture/render_textured.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "mesh/light/mesh_raster.h"
#include "mesh/light/turn_light.h"

namespace s2gs {
namespace {

Eigen::Array3d ReadTexel(const Image8& page, const Eigen::Vector2d& position) {
  const double x = std::clamp(position.x() - 0.5, 0.0, page.width - 1.0);
  const double y = std::clamp(position.y() - 0.5, 0.0, page.height - 1.0);
  const int x0 = std::max(0, std::min(static_cast<int>(x), page.width - 2));
  const int y0 = std::max(0, std::min(static_cast<int>(y), page.height - 2));
  const int x1 = std::min(x0 + 1, page.width - 1);
  const int y1 = std::min(y0 + 1, page.height - 1);
  const double fx = x - x0;
  const double fy = y - y0;
  Eigen::Array3d value;
  for (int c = 0; c < 3; ++c) {
    value[c] = (1 - fy) * ((1 - fx) * page.Pixel(x0, y0)[c] + fx * page.Pixel(x1, y0)[c]) +
               fy * ((1 - fx) * page.Pixel(x0, y1)[c] + fx * page.Pixel(x1, y1)[c]);
  }
  return value;
}

}  // namespace

TexturedRendering RenderTexturedMesh(const TexturedMesh& mesh, const ObjectView& view, int samples,
                                     const ShadeAt& shade) {
  ObjectView fine = view;
  fine.width *= samples;
  fine.height *= samples;
  fine.fx *= samples;
  fine.fy *= samples;
  fine.cx *= samples;
  fine.cy *= samples;
  const MeshRaster raster = RasterizeMesh(mesh.vertices, mesh.triangles, fine, true);
  std::vector<uint32_t> page_ends;
  page_ends.reserve(mesh.pages.size());
  for (const TexturePage& page : mesh.pages) {
    page_ends.push_back(static_cast<uint32_t>(page.first_triangle + page.num_triangles));
  }
  const Rigid3 object_from_cam = view.cam_from_object.Inverse();
  const Eigen::Vector3d center = object_from_cam.translation;
  const size_t num_pixels = static_cast<size_t>(view.width) * view.height;
  TexturedRendering result;
  result.image = {view.width, view.height, 3, std::vector<uint8_t>(3 * num_pixels, 0)};
  result.covered = {view.width, view.height, std::vector<uint8_t>(num_pixels, 0)};
  for (int row = 0; row < view.height; ++row) {
    for (int column = 0; column < view.width; ++column) {
      Eigen::Array3d sum = Eigen::Array3d::Zero();
      int count = 0;
      for (int i = 0; i < samples * samples; ++i) {
        const int x = column * samples + i % samples;
        const int y = row * samples + i / samples;
        const uint32_t t = raster.triangles[static_cast<size_t>(y) * fine.width + x];
        if (t == MeshRaster::kNone) continue;
        const Triangle& corners = mesh.triangles[t];
        // The ray meets the triangle's plane at a + s e + r f; Moller and Trumbore, "Fast, minimum storage
        // ray-triangle intersection" (1997).
        const Eigen::Vector3d ray =
            object_from_cam.rotation *
            Eigen::Vector3d((x + 0.5 - fine.cx) / fine.fx, (y + 0.5 - fine.cy) / fine.fy, 1);
        const Eigen::Vector3d a = mesh.vertices[corners[0]].cast<double>();
        const Eigen::Vector3d e = mesh.vertices[corners[1]].cast<double>() - a;
        const Eigen::Vector3d f = mesh.vertices[corners[2]].cast<double>() - a;
        const Eigen::Vector3d across = ray.cross(f);
        const double determinant = e.dot(across);
        const Eigen::Vector3d from_a = center - a;
        double s = from_a.dot(across) / determinant;
        double r = ray.dot(from_a.cross(e)) / determinant;
        // Edge-on, where both are of rounding alone.
        if (!std::isfinite(s) || !std::isfinite(r)) s = r = 0;
        s = std::clamp(s, 0.0, 1.0);
        r = std::clamp(r, 0.0, 1.0 - s);
        const Eigen::Vector2d position = (1 - s - r) * mesh.texels[corners[0]].cast<double>() +
                                         s * mesh.texels[corners[1]].cast<double>() +
                                         r * mesh.texels[corners[2]].cast<double>();
        const auto page = std::upper_bound(page_ends.begin(), page_ends.end(), t) - page_ends.begin();
        Eigen::Array3d color = ReadTexel(mesh.pages[page].image, position);
        if (shade) {
          const Eigen::Array3f light = shade(t, static_cast<float>(1 - s - r), static_cast<float>(s));
          color = UnderLight(color.cast<float>(), light).cast<double>();
        }
        sum += color;
        ++count;
      }
      if (count == 0) continue;
      uint8_t* pixel = result.image.Pixel(column, row);
      for (int c = 0; c < 3; ++c)
        pixel[c] = static_cast<uint8_t>(std::lround(std::min(255.0, sum[c] / count)));
      result.covered.inside[static_cast<size_t>(row) * view.width + column] = 1;
    }
  }
  return result;
}

}  // namespace s2gs
