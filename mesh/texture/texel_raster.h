#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>

namespace s2gs {

/// A triangle's corners in a picture [px].
using TexelTriangle = std::array<Eigen::Vector2f, 3>;

/// A texel whose centre lies in a triangle, or on its border.
struct Texel {
  int x = 0;
  int y = 0;
  std::array<float, 3> weights = {};  ///< barycentric coordinates of its centre.
  bool is_inside = false;             ///< clearly: not on an edge, where two triangles meet.
};

/// Calls `use(Texel)` for every texel of a width x height picture whose centre lies in the triangle. Texels
/// on an edge come up for both triangles that share it.
template <typename Use>
void ForEachTexel(const TexelTriangle& corners, int width, int height, const Use& use) {
  // In barycentric coordinates.
  constexpr float kEdge = 1e-5F;
  constexpr float kClear = 1e-3F;
  const auto& [a, b, c] = corners;
  const auto cross = [](const Eigen::Vector2f& o, const Eigen::Vector2f& p, const Eigen::Vector2f& q) {
    return (p.x() - o.x()) * (q.y() - o.y()) - (q.x() - o.x()) * (p.y() - o.y());
  };
  const float area = cross(a, b, c);
  if (!(std::abs(area) > 1e-12F)) return;
  const Eigen::Vector2f low = a.cwiseMin(b).cwiseMin(c);
  const Eigen::Vector2f high = a.cwiseMax(b).cwiseMax(c);
  const int first_x = std::max(0, static_cast<int>(std::ceil(low.x() - 0.5F)));
  const int first_y = std::max(0, static_cast<int>(std::ceil(low.y() - 0.5F)));
  const int last_x = std::min(width - 1, static_cast<int>(std::floor(high.x() - 0.5F)));
  const int last_y = std::min(height - 1, static_cast<int>(std::floor(high.y() - 0.5F)));
  for (int y = first_y; y <= last_y; ++y) {
    for (int x = first_x; x <= last_x; ++x) {
      const Eigen::Vector2f centre(static_cast<float>(x) + 0.5F, static_cast<float>(y) + 0.5F);
      const float u = cross(centre, b, c) / area;
      const float v = cross(centre, c, a) / area;
      const float w = 1 - u - v;
      const float least = std::min({u, v, w});
      if (least < -kEdge) continue;
      use(Texel{x, y, {u, v, w}, least > kClear});
    }
  }
}

}  // namespace s2gs
