#include "s2gs/view_maps.h"

#include <Eigen/Core>

namespace s2gs {
namespace {

constexpr float kOpaqueFrom = 0.5F;  // half of the light

}  // namespace

const std::vector<float>& DepthsOf(const RenderedView& view, DepthKind kind) {
  return kind == DepthKind::kMedian ? view.median_depth : view.expected_depth;
}

PixelMask OpaqueMask(const RenderedView& view) {
  PixelMask mask{view.width, view.height, {}};
  mask.inside.reserve(view.alpha.size());
  for (const float alpha : view.alpha) mask.inside.push_back(alpha >= kOpaqueFrom ? 1 : 0);
  return mask;
}

ViewMaps ColmapMapsOf(const RenderedView& view, DepthKind kind, double scene_size) {
  const std::vector<float>& depth = DepthsOf(view, kind);
  ViewMaps maps{{view.width, view.height, 1, {}}, {view.width, view.height, 3, {}}};
  const size_t count = depth.size();
  maps.depth.values.assign(count, 0);
  maps.normal.values.assign(3 * count, 0);
  for (size_t i = 0; i < count; ++i) {
    if (!(depth[i] > 0) || view.alpha[i] < kOpaqueFrom) continue;
    const Eigen::Vector3f normal(view.normal[3 * i], view.normal[3 * i + 1], view.normal[3 * i + 2]);
    const float length = normal.norm();
    if (!(length > 0)) continue;
    maps.depth.values[i] = static_cast<float>(depth[i] * scene_size);
    for (int c = 0; c < 3; ++c) maps.normal.values[c * count + i] = normal[c] / length;
  }
  return maps;
}

}  // namespace s2gs
