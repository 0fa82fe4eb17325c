#include "tests/mesh/fusion/analytic_views.h"

#include <cmath>
#include <optional>

#include "sfm_split/base/angles.h"

namespace s2gs {
namespace {

Rigid3 LookAt(const Eigen::Vector3d& position, const Eigen::Vector3d& target, double roll) {
  const Eigen::Vector3d forward = (target - position).normalized();
  const Eigen::Vector3d up =
      std::abs(forward.z()) < 0.9 ? Eigen::Vector3d::UnitZ() : Eigen::Vector3d::UnitX();
  const Eigen::Vector3d right = forward.cross(up).normalized();
  Eigen::Matrix3d rotation;
  rotation << right.transpose(), forward.cross(right).transpose(), forward.transpose();
  Rigid3 cam_from_object;
  cam_from_object.rotation =
      Eigen::Quaterniond(Eigen::AngleAxisd(roll, Eigen::Vector3d::UnitZ()) * rotation).normalized();
  cam_from_object.translation = -(cam_from_object.rotation * position);
  return cam_from_object;
}

}  // namespace

Eigen::Array3d AnalyticColor(const Eigen::Vector3d& normal) { return 128 + 100 * normal.array(); }

Shape SphereShape(double radius) {
  Shape shape;
  shape.kind = ShapeKind::kSphere;
  shape.size = Eigen::Vector3d::Constant(radius);
  return shape;
}

Shape BoxShape(const Eigen::Vector3d& half_edges, const Rigid3& object_from_box) {
  Shape shape;
  shape.kind = ShapeKind::kBox;
  shape.size = half_edges;
  shape.frame_from_shape = object_from_box;
  return shape;
}

std::vector<DepthView> AnalyticViews(const std::vector<Shape>& shapes, const AnalyticViewOptions& options) {
  std::vector<DepthView> views;
  views.reserve(options.num_views);
  for (int i = 0; i < options.num_views; ++i) {
    // Directions on a spiral from pole to pole.
    const double z = options.ring_elevation_deg < 0 ? 1 - 2 * (i + 0.5) / options.num_views
                                                    : std::sin(options.ring_elevation_deg * kDegree);
    const double angle = i * kPi * (3 - std::sqrt(5.0));
    const double r = std::sqrt(1 - z * z);
    const Eigen::Vector3d direction(r * std::cos(angle), r * std::sin(angle), z);
    DepthView view;
    view.camera = {options.width,
                   options.height,
                   options.focal,
                   1.1 * options.focal,
                   options.principal_point.x(),
                   options.principal_point.y(),
                   LookAt(options.middle + options.distance * direction, options.middle, 0.3 * i)};
    view.first_position = options.first_position;
    const size_t num_pixels = static_cast<size_t>(options.width) * options.height;
    view.depths.assign(num_pixels, 0);
    if (options.with_normals) view.normals.assign(3 * num_pixels, 0);
    if (options.with_colors)
      view.colors = {options.width, options.height, 3, std::vector<uint8_t>(3 * num_pixels)};
    if (options.with_mask) view.mask = {options.width, options.height, 1, std::vector<uint8_t>(num_pixels)};
    const Rigid3 object_from_cam = view.camera.cam_from_object.Inverse();
    const auto hit_at = [&](double u, double v) {
      const Eigen::Vector3d ray((u - view.camera.cx) / view.camera.fx, (v - view.camera.cy) / view.camera.fy,
                                1);
      std::optional<RayHit> nearest;
      for (const Shape& shape : shapes) {
        const std::optional<RayHit> hit =
            Intersect(shape, {object_from_cam.translation, object_from_cam.rotation * ray});
        if (hit && (!nearest || hit->t < nearest->t)) nearest = hit;
      }
      return nearest;
    };
    for (int y = 0; y < options.height; ++y) {
      for (int x = 0; x < options.width; ++x) {
        const size_t pixel = static_cast<size_t>(y) * options.width + x;
        const std::optional<RayHit> hit =
            hit_at(x + options.first_position.x(), y + options.first_position.y());
        if (hit) {
          view.depths[pixel] = static_cast<float>(options.scale * hit->t);
          const Eigen::Vector3d normal = view.camera.cam_from_object.rotation * hit->normal;
          for (int c = 0; c < 3 && options.with_normals; ++c) {
            view.normals[c * num_pixels + pixel] = static_cast<float>(normal[c]);
          }
        }
        // Images are sampled at the pixels' centres, wherever the depths are.
        const std::optional<RayHit> seen = hit_at(x + 0.5, y + 0.5);
        if (!seen) continue;
        if (options.with_mask) view.mask.pixels[pixel] = 255;
        for (int c = 0; c < 3 && options.with_colors; ++c) {
          view.colors.pixels[3 * pixel + c] =
              static_cast<uint8_t>(std::lround(AnalyticColor(seen->normal)[c]));
        }
      }
    }
    view.camera.cam_from_object.translation *= options.scale;
    views.push_back(std::move(view));
  }
  return views;
}

}  // namespace s2gs
