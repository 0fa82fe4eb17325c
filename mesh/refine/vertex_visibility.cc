#include "mesh/refine/vertex_visibility.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

// How far behind the rendered surface a vertex still lies on it, in pixels at its depth: the surface's own
// slope over the distance to the pixel's centre, and the mesh's coarseness.
constexpr float kDepthTolerance = 2;
constexpr float kSlopePerPixel = 1.5F;
// Between the places of the margin that are looked at [px].
constexpr int kMarginStep = 2;
// A pixel centre this far outside of a triangle, in barycentric coordinates, is on its edge.
constexpr float kEdgeTolerance = 1e-4F;

// A view with its numbers as the loops need them.
struct FloatView {
  explicit FloatView(const ObjectView& view)
      : rotation(view.cam_from_object.rotation.toRotationMatrix().cast<float>()),
        translation(view.cam_from_object.translation.cast<float>()),
        center(CameraCentre(view.cam_from_object).cast<float>()),
        focal(static_cast<float>(view.fx), static_cast<float>(view.fy)),
        principal(static_cast<float>(view.cx), static_cast<float>(view.cy)) {}

  Eigen::Vector3f InCamera(const Eigen::Vector3f& x) const { return rotation * x + translation; }
  Eigen::Vector2f Project(const Eigen::Vector3f& x_in_cam) const {
    return focal.cwiseProduct(x_in_cam.head<2>()) / x_in_cam.z() + principal;
  }

  Eigen::Matrix3f rotation;
  Eigen::Vector3f translation;
  Eigen::Vector3f center;
  Eigen::Vector2f focal;
  Eigen::Vector2f principal;
};

// Twice the signed area of the triangle a, b, c in the image.
float Cross(const Eigen::Vector3f& a, const Eigen::Vector3f& b, const Eigen::Vector3f& c) {
  return (b.x() - a.x()) * (c.y() - a.y()) - (c.x() - a.x()) * (b.y() - a.y());
}

// First and last whole number in [low, high] and [0, size - 1], for high >= 0 and low < size. Truncated by
// hand: most triangles hold no pixel's centre, and std::ceil and std::floor are calls.
struct PixelRange {
  PixelRange(float low, float high, int size)
      : first(static_cast<int>(std::max(low, 0.0F))),
        last(static_cast<int>(std::min(high, static_cast<float>(size - 1)))) {
    if (static_cast<float>(first) < low) ++first;
  }
  int first;
  int last;
};

// A picture of depths that triangles are drawn into, in any order: of two at one depth the one of the lower
// number is in front.
class DepthPicture {
 public:
  // \param triangle_at  which triangle each pixel's centre shows, -1: none; may be null where triangles are
  // drawn by ascending numbers.
  DepthPicture(const TriangleMesh& mesh, const ObjectView& view, std::vector<int32_t>* triangle_at)
      : mesh_(mesh), width_(view.width), height_(view.height), triangle_at_(triangle_at) {
    const size_t size = static_cast<size_t>(width_) * height_;
    if (triangle_at_ != nullptr) triangle_at_->assign(size, -1);
    depths_.assign(size, std::numeric_limits<float>::infinity());
    const FloatView camera(view);
    projected_.reserve(mesh.vertices.size());
    for (const Eigen::Vector3f& vertex : mesh.vertices) {
      const Eigen::Vector3f x = camera.InCamera(vertex);
      const Eigen::Vector2f p = camera.Project(x);
      projected_.emplace_back(p.x() - 0.5F, p.y() - 0.5F, x.z());
    }
  }

  void Draw(size_t triangle);
  std::vector<float>& depths() { return depths_; }

 private:
  const TriangleMesh& mesh_;
  const int width_, height_;
  std::vector<int32_t>* const triangle_at_;
  std::vector<float> depths_;
  // Column and row of each vertex, counted from the centre of the first pixel, and its depth.
  std::vector<Eigen::Vector3f> projected_;
};

void DepthPicture::Draw(size_t triangle) {
  const auto& corners = mesh_.triangles[triangle];
  const Eigen::Vector3f& a = projected_[corners[0]];
  const Eigen::Vector3f& b = projected_[corners[1]];
  const Eigen::Vector3f& c = projected_[corners[2]];
  if (!(a.z() > 0 && b.z() > 0 && c.z() > 0)) return;
  const float area = Cross(a, b, c);
  if (!(std::abs(area) > std::numeric_limits<float>::min())) return;
  const float min_x = std::min(std::min(a.x(), b.x()), c.x());
  const float max_x = std::max(std::max(a.x(), b.x()), c.x());
  const float min_y = std::min(std::min(a.y(), b.y()), c.y());
  const float max_y = std::max(std::max(a.y(), b.y()), c.y());
  if (!(max_x >= 0 && max_y >= 0 && min_x < static_cast<float>(width_) &&
        min_y < static_cast<float>(height_))) {
    return;
  }
  const auto id = static_cast<int32_t>(triangle);
  const PixelRange columns(min_x, max_x, width_);
  const PixelRange rows(min_y, max_y, height_);
  for (int row = rows.first; row <= rows.last; ++row) {
    for (int column = columns.first; column <= columns.last; ++column) {
      const Eigen::Vector3f pixel(static_cast<float>(column), static_cast<float>(row), 0);
      const float u = Cross(pixel, b, c) / area;
      const float v = Cross(pixel, c, a) / area;
      const float w = 1 - u - v;
      if (u < -kEdgeTolerance || v < -kEdgeTolerance || w < -kEdgeTolerance) continue;
      const size_t at = static_cast<size_t>(row) * width_ + column;
      const float depth = u * a.z() + v * b.z() + w * c.z();
      const float there = depths_[at];
      if (triangle_at_ == nullptr) {
        if (depth < there) depths_[at] = depth;
      } else if (depth < there || (depth == there && id < (*triangle_at_)[at])) {
        depths_[at] = depth;
        (*triangle_at_)[at] = id;
      }
    }
  }
}

}  // namespace

std::vector<float> RenderMeshDepth(const TriangleMesh& mesh, const ObjectView& view,
                                   std::vector<int32_t>* triangle_at) {
  DepthPicture picture(mesh, view, triangle_at);
  for (size_t i = 0; i < mesh.triangles.size(); ++i) picture.Draw(i);
  return std::move(picture.depths());
}

ShownTriangles FindShownTriangles(const TriangleMesh& mesh, const std::vector<bool>& keep,
                                  const ObjectView& view) {
  S2GS_INVARIANT(keep.size() == mesh.triangles.size());
  ShownTriangles shown;
  DepthPicture picture(mesh, view, &shown.of_all);
  for (size_t i = 0; i < keep.size(); ++i) {
    if (keep[i]) picture.Draw(i);
  }
  shown.of_kept = shown.of_all;
  for (size_t i = 0; i < keep.size(); ++i) {
    if (!keep[i]) picture.Draw(i);
  }
  return shown;
}

VertexFlags FindVisibleVertices(const TriangleMesh& mesh, const ObjectView& view,
                                const VisibilityRule& rule) {
  S2GS_INVARIANT(mesh.normals.size() == mesh.vertices.size());
  const FloatView camera(view);
  const std::vector<float> depths = RenderMeshDepth(mesh, view);
  const float pixel_per_depth = 1 / std::max(camera.focal.x(), camera.focal.y());
  const auto border = static_cast<float>(rule.margin);
  VertexFlags visible(mesh.vertices.size());
  for (size_t i = 0; i < mesh.vertices.size(); ++i) {
    const Eigen::Vector3f to_camera = camera.center - mesh.vertices[i];
    const float cosine = mesh.normals[i].dot(to_camera) / to_camera.norm();
    const Eigen::Vector3f x = camera.InCamera(mesh.vertices[i]);
    if (!(cosine >= rule.min_cosine) || !(cosine > 0) || !(x.z() > 0)) continue;
    const Eigen::Vector2f p = camera.Project(x);
    if (!(p.x() >= border && p.y() >= border && p.x() < static_cast<float>(view.width) - border &&
          p.y() < static_cast<float>(view.height) - border)) {
      continue;
    }
    const float slope = std::sqrt(std::max(0.0F, 1 - cosine * cosine)) / cosine;
    const float tolerance = (kDepthTolerance + (1 + kSlopePerPixel * border) * slope) * pixel_per_depth;
    const float farthest = x.z() - tolerance * x.z();
    const auto at = [&](int dx, int dy) {
      return depths[(static_cast<size_t>(p.y()) + dy) * view.width + static_cast<size_t>(p.x()) + dx];
    };
    bool is_visible = at(0, 0) >= farthest;
    if (rule.margin > 0) {
      for (int dy = -rule.margin; dy <= rule.margin && is_visible; dy += kMarginStep) {
        for (int dx = -rule.margin; dx <= rule.margin && is_visible; dx += kMarginStep) {
          const float depth = at(dx, dy);
          is_visible = depth >= farthest && std::isfinite(depth);
        }
      }
    }
    if (is_visible) visible.Set(i);
  }
  return visible;
}

}  // namespace s2gs
