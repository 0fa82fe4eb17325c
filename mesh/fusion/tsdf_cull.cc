#include "mesh/fusion/tsdf_cull.h"

#include <algorithm>
#include <limits>

namespace s2gs {
namespace {

constexpr int kTile = 16;  // [px]

}  // namespace

TsdfDepthTiles MakeTsdfDepthTiles(const TsdfView& view, double truncation, double voxel_size) {
  constexpr float kInfinite = std::numeric_limits<float>::infinity();
  TsdfDepthTiles tiles;
  tiles.columns = (view.map_width + kTile - 1) / kTile;
  tiles.rows = (view.map_height + kTile - 1) / kTile;
  tiles.far.assign(static_cast<size_t>(tiles.columns) * tiles.rows, 0);
  tiles.far_outside_map = view.planes[kOutsideMap].weight < 0 ? kInfinite : 0;
  // SampleView's own limit. Inside a steep pixel the depth varies by some pixels.
  const double behind = 2.01 * std::min(truncation, kMaxBehind * voxel_size);
  const double slope = 1 + 8 / std::min(view.camera.fx, view.camera.fy);
  for (int row = 0; row < view.map_height; ++row) {
    const PixelPlane* planes = &view.planes[kFirstPixel + static_cast<size_t>(row) * view.map_width];
    float* far_row = &tiles.far[static_cast<size_t>(row / kTile) * tiles.columns];
    for (int column = 0; column < view.map_width; ++column) {
      const PixelPlane& plane = planes[column];
      if (plane.weight == 0) continue;
      float far = kInfinite;
      if (plane.weight > 0) {
        const Eigen::Vector3d ray = view.Ray(column, row);
        const double inverse_depth = plane.a * ray.x() + plane.b * ray.y() + plane.c;
        if (inverse_depth > 0) far = static_cast<float>(slope / inverse_depth + behind);
      }
      far_row[column / kTile] = std::max(far_row[column / kTile], far);
    }
  }
  return tiles;
}

bool MayMatter(const TsdfViewParams& view, const TsdfDepthTiles& tiles, const float* middle, float radius) {
  const float near = middle[2] - radius;
  const float far = middle[2] + radius;
  if (far <= 0) return false;
  if (near <= 0.01F * far) return true;
  const auto low = [&](float x, float f, float c) {
    const float edge = x - radius;
    return f * edge / (edge > 0 ? far : near) + c - 1;
  };
  const auto high = [&](float x, float f, float c) {
    const float edge = x + radius;
    return f * edge / (edge > 0 ? near : far) + c + 1;
  };
  const float u0 = low(middle[0], view.fx, view.cx);
  const float u1 = high(middle[0], view.fx, view.cx);
  const float v0 = low(middle[1], view.fy, view.cy);
  const float v1 = high(middle[1], view.fy, view.cy);
  if (u1 < 0 || v1 < 0 || u0 >= view.width || v0 >= view.height) return false;
  const float map_u0 = u0 - view.map_x;
  const float map_u1 = u1 - view.map_x;
  const float map_v0 = v0 - view.map_y;
  const float map_v1 = v1 - view.map_y;
  const bool leaves_map = map_u0 < 0 || map_v0 < 0 || map_u1 >= view.map_width || map_v1 >= view.map_height;
  if (leaves_map && tiles.far_outside_map > 0) return true;
  if (tiles.far.empty()) return false;  // A view that shows no object has no map.
  if (map_u1 < 0 || map_v1 < 0 || map_u0 >= view.map_width || map_v0 >= view.map_height) return false;
  const auto tile = [](float position, int count) {
    return std::clamp(static_cast<int>(position / kTile), 0, count - 1);
  };
  const int column1 = tile(map_u1, tiles.columns);
  const int row1 = tile(map_v1, tiles.rows);
  for (int row = tile(map_v0, tiles.rows); row <= row1; ++row) {
    for (int column = tile(map_u0, tiles.columns); column <= column1; ++column) {
      if (tiles.far[static_cast<size_t>(row) * tiles.columns + column] >= near) return true;
    }
  }
  return false;
}

}  // namespace s2gs
