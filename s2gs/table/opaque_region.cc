#include "s2gs/table/opaque_region.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstddef>

namespace s2gs {
RegionView::RegionView(const RotatingRegion& region, const PinholeView& view)
    : view_(view), up_(region.axis.direction), radius_(region.radius) {
  const Rigid3 world_from_cam = view.cam_from_world.Inverse();
  world_from_cam_ = world_from_cam.rotation.matrix();
  const Eigen::Vector3d from = world_from_cam.translation - region.axis.point;
  const double from_height = from.dot(up_);
  from_level_ = from - from_height * up_;
  low_ = region.low - from_height;
  high_ = region.high - from_height;
}

std::optional<RegionHit> RegionView::At(int x, int y) const {
  const Eigen::Vector3d in_camera((x + 0.5 - view_.cx) / view_.fx, (y + 0.5 - view_.cy) / view_.fy, 1);
  const Eigen::Vector3d ray = world_from_cam_ * in_camera;
  const double climb = ray.dot(up_);
  const Eigen::Vector3d level = ray - climb * up_;
  // Between where the ray enters and leaves the endless cylinder and the slab.
  const double a = level.squaredNorm();
  const double b = level.dot(from_level_);
  const double c = from_level_.squaredNorm() - radius_ * radius_;
  if (!(b * b >= a * c) || !(a > 0)) return std::nullopt;
  const double root = std::sqrt(b * b - a * c);
  const double into_side = (-b - root) / a;
  const double into_slab = std::min(low_ / climb, high_ / climb);
  const double first = std::max({into_side, into_slab, view_.near_depth});
  const double last = std::min((-b + root) / a, std::max(low_ / climb, high_ / climb));
  if (!(first <= last)) return std::nullopt;
  RegionHit hit{first, -in_camera.normalized()};
  if (first == into_slab) {
    hit.normal = world_from_cam_.transpose() * (climb < 0 ? up_ : Eigen::Vector3d(-up_));
  } else if (first == into_side) {
    hit.normal = world_from_cam_.transpose() * (from_level_ + first * level).normalized();
  }
  return hit;
}

void AddRegion(const RotatingRegion& region, const PinholeView& view, PixelMask* mask) {
  const RegionView seen(region, view);
  for (int y = 0; y < mask->height; ++y) {
    for (int x = 0; x < mask->width; ++x) {
      if (seen.At(x, y)) mask->inside[static_cast<size_t>(y) * mask->width + x] = 1;
    }
  }
}

namespace {

void DrawHit(const RegionHit& hit, size_t pixel, RenderedView* rendered) {
  const auto depth = static_cast<float>(hit.depth);
  rendered->alpha[pixel] = 1;
  rendered->median_depth[pixel] = depth;
  rendered->expected_depth[pixel] = depth;
  for (int k = 0; k < 3; ++k) rendered->normal[3 * pixel + k] = static_cast<float>(hit.normal[k]);
}

}  // namespace

void DrawOpaqueRegion(const RotatingRegion& region, const PinholeView& view, RenderedView* rendered) {
  const RegionView seen(region, view);
  for (int y = 0; y < rendered->height; ++y) {
    for (int x = 0; x < rendered->width; ++x) {
      const std::optional<RegionHit> hit = seen.At(x, y);
      if (!hit) continue;
      const size_t i = static_cast<size_t>(y) * rendered->width + x;
      const auto depth = static_cast<float>(hit->depth);
      const auto is_before = [depth](float other) { return other > 0 && other <= depth; };
      if (rendered->alpha[i] >= kOpaque && is_before(rendered->median_depth[i])) continue;
      DrawHit(*hit, i, rendered);
    }
  }
}

void DrawRegionWhereSeen(const RotatingRegion& region, const MarkedPixels& seen, const PinholeView& view,
                         RenderedView* rendered) {
  const RegionView hits(region, view);
  const auto pixel_of = [](double pixel, double center, double focal, double to_center, double to_focal) {
    return static_cast<int>(std::floor((pixel + 0.5 - center) / focal * to_focal + to_center));
  };
  for (int y = 0; y < rendered->height; ++y) {
    const int row = pixel_of(y, view.cy, view.fy, seen.view.cy, seen.view.fy);
    if (row < 0 || row >= seen.marks.height) continue;
    for (int x = 0; x < rendered->width; ++x) {
      const int column = pixel_of(x, view.cx, view.fx, seen.view.cx, seen.view.fx);
      if (column < 0 || column >= seen.marks.width || *seen.marks.Pixel(column, row) != 255) continue;
      const std::optional<RegionHit> hit = hits.At(x, y);
      if (hit) DrawHit(*hit, static_cast<size_t>(y) * rendered->width + x, rendered);
    }
  }
}

}  // namespace s2gs
