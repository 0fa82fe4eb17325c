#include "sfm_split/circular_motion/circular_lens.h"

#include <algorithm>
#include <cmath>

namespace s2gs {

using Eigen::Vector2d;

LensPoint ThroughLens(const CircularLens& lens, double focal, const Vector2d& xy) {
  const Vector2d distorted = xy / focal;
  const double rd = distorted.norm();
  const double k = lens.distortion;
  double r = rd;
  if (k != 0) {
    // The lens turns back where 1 + 3 k r^2 = 0.
    if (k < 0 && rd >= 2 / std::sqrt(-27 * k)) return {};
    for (int iteration = 0; iteration < 8; ++iteration) {
      r -= (r * (1 + k * r * r) - rd) / std::max(1 + 3 * k * r * r, 0.05);
    }
  }
  LensPoint point;
  const double slope = 1 + 3 * k * r * r;
  if (!(slope > 0.05) || !std::isfinite(r)) return {};
  const double ratio = 1 / (1 + k * r * r);
  point.is_valid = true;
  const Vector2d u = ratio * distorted;
  point.ray << u, 1;
  point.by_log_focal << -u * (1 / (ratio * slope)), 0;
  point.by_distortion << -u * (r * r / slope), 0;
  point.px = focal * (1 + 2 * k * r * r);
  return point;
}

}  // namespace s2gs
