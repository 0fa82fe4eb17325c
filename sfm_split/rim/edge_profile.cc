#include "sfm_split/rim/edge_profile.h"

#include <cmath>
#include <cstddef>

namespace s2gs {
namespace {

using Eigen::Vector2d;

constexpr double kBesidePx = 1.5;  // lines beside each other that an edge is the mean of

}  // namespace

EdgeProfile::EdgeProfile(const EdgePicture& picture, const SearchedCircles::Crossing& at, double reach_px) {
  const Vector2d along(-at.normal.y(), at.normal.x());
  const int reach = static_cast<int>(std::lround(reach_px / kStepPx));
  const int apart = static_cast<int>(std::lround(1 / kStepPx));  // two pixels from one side to the other
  std::vector<float> grey;
  for (int i = -reach - apart; i <= reach + apart; ++i) {
    float sum = 0;
    for (const int line : {-1, 0, 1}) {
      const Vector2d xy = at.xy + i * kStepPx * at.normal + line * kBesidePx * along;
      if (!picture.Contains(xy)) return;
      sum += picture.BrightnessAt(xy);
    }
    grey.push_back(sum / 3);
  }
  for (size_t i = 0; i + 2 * static_cast<size_t>(apart) < grey.size(); ++i)
    slopes_.push_back(std::abs(grey[i + 2 * static_cast<size_t>(apart)] - grey[i]));
  reach_ = reach;
}

std::vector<EdgeProfile::Edge> EdgeProfile::Edges() const {
  std::vector<Edge> edges;
  for (size_t i = 1; i + 1 < slopes_.size(); ++i) {
    const double before = slopes_[i - 1];
    const double here = slopes_[i];
    const double after = slopes_[i + 1];
    if (!(here > before && here >= after)) continue;
    const double curvature = before - 2 * here + after;
    const double aside = curvature < 0 ? 0.5 * (before - after) / curvature : 0;
    edges.push_back({(static_cast<double>(i) - reach_ + aside) * kStepPx, here});
  }
  return edges;
}

}  // namespace s2gs
