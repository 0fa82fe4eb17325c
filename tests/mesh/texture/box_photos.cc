#include "tests/mesh/texture/box_photos.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "tests/support/camera_towards_origin.h"

namespace s2gs {
namespace {

// Along the ray to the box's near side; infinite where it misses.
double HitDistance(const PaintedBox& box, const Eigen::Vector3d& from, const Eigen::Vector3d& ray) {
  double near = 0;
  double far = std::numeric_limits<double>::infinity();
  for (int axis = 0; axis < 3; ++axis) {
    const double a = (box.low[axis] - from[axis]) / ray[axis];
    const double b = (box.high[axis] - from[axis]) / ray[axis];
    near = std::max(near, std::min(a, b));
    far = std::min(far, std::max(a, b));
  }
  return near < far ? near : std::numeric_limits<double>::infinity();
}

}  // namespace

TriangleMesh MeshOf(const std::vector<PaintedBox>& boxes) {
  TriangleMesh mesh;
  for (const PaintedBox& box : boxes) {
    const auto first = static_cast<uint32_t>(mesh.vertices.size());
    for (int corner = 0; corner < 8; ++corner) {
      const Eigen::Vector3d x((corner & 1) != 0 ? box.high.x() : box.low.x(),
                              (corner & 2) != 0 ? box.high.y() : box.low.y(),
                              (corner & 4) != 0 ? box.high.z() : box.low.z());
      mesh.vertices.push_back(x.cast<float>());
    }
    for (const auto& quad : {std::array<uint32_t, 4>{0, 4, 6, 2}, std::array<uint32_t, 4>{1, 3, 7, 5},
                             std::array<uint32_t, 4>{0, 1, 5, 4}, std::array<uint32_t, 4>{2, 6, 7, 3},
                             std::array<uint32_t, 4>{0, 2, 3, 1}, std::array<uint32_t, 4>{4, 5, 7, 6}}) {
      mesh.triangles.emplace_back(first + quad[0], first + quad[1], first + quad[2]);
      mesh.triangles.emplace_back(first + quad[0], first + quad[2], first + quad[3]);
    }
  }
  return mesh;
}

ObjectView LookAtOrigin(const Eigen::Vector3d& center, int side, double focal) {
  return {side, side, focal, focal, side / 2.0 + 1.7, side / 2.0 - 2.3, CameraTowardsOrigin(center)};
}

BoxPhotos::BoxPhotos(std::vector<PaintedBox> boxes, std::vector<ObjectView> views)
    : views_(std::move(views)) {
  constexpr int kRays = 4;
  for (const ObjectView& view : views_) {
    Image8 photo{view.width, view.height, 3,
                 std::vector<uint8_t>(3 * static_cast<size_t>(view.width) * view.height)};
    const Rigid3 object_from_cam = view.cam_from_object.Inverse();
    for (int y = 0; y < view.height; ++y) {
      for (int x = 0; x < view.width; ++x) {
        Eigen::Array3d sum = Eigen::Array3d::Zero();
        for (int i = 0; i < kRays * kRays; ++i) {
          const double column = x + (i % kRays + 0.5) / kRays;
          const double row = y + (i / kRays + 0.5) / kRays;
          const Eigen::Vector3d ray =
              object_from_cam.rotation *
              Eigen::Vector3d((column - view.cx) / view.fx, (row - view.cy) / view.fy, 1);
          double nearest = std::numeric_limits<double>::infinity();
          Eigen::Array3d color(90, 90, 90);
          for (const PaintedBox& box : boxes) {
            const double distance = HitDistance(box, object_from_cam.translation, ray);
            if (distance >= nearest) continue;
            nearest = distance;
            color = box.color(object_from_cam.translation + distance * ray);
          }
          sum += color;
        }
        for (int c = 0; c < 3; ++c) {
          photo.Pixel(x, y)[c] =
              static_cast<uint8_t>(std::lround(std::clamp(sum[c] / (kRays * kRays), 0.0, 255.0)));
        }
      }
    }
    photos_.push_back(std::move(photo));
  }
}

}  // namespace s2gs
