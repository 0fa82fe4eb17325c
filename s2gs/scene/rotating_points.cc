#include <algorithm>
#include <optional>
#include <utility>
#include <vector>

#include "s2gs/scene/scene_files.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

constexpr double kRegionQuantile = 0.995;  // of the rotating points: the few beyond are outliers.
constexpr double kRegionMargin = 1.15;     // SfM points end before the surface does.
constexpr double kRegionSlack = 0.25;   // of the radius: the plain side of a disc whose top alone has points.
constexpr size_t kRaysThatBearOut = 3;  // a point
constexpr size_t kMinPointsForRegion = 20;  // fewer say nothing about where it ends.

bool IsBorneOut(const ColmapPoint3D& point) { return point.track.size() >= kRaysThatBearOut; }

}  // namespace

std::optional<RotatingRegion> FindRegion(const SceneFiles& files) {
  if (files.mode != TrainMode::kS2gs || files.object.points3D.size() < kMinPointsForRegion)
    return std::nullopt;
  RotatingRegion region;
  region.axis = files.turntable->axis;
  // Two rays that meet may do so by chance, of someone who walks by, say; a third bears a point out.
  const size_t num_borne_out = std::count_if(files.object.points3D.begin(), files.object.points3D.end(),
                                             [](const auto& entry) { return IsBorneOut(entry.second); });
  const bool all_count = num_borne_out < kMinPointsForRegion;
  std::vector<double> radii;
  std::vector<double> heights;
  radii.reserve(files.object.points3D.size());
  heights.reserve(files.object.points3D.size());
  for (const auto& [id, point] : files.object.points3D) {
    if (!all_count && !IsBorneOut(point)) continue;
    const Eigen::Vector3d from_axis = point.xyz - region.axis.point;
    const double height = from_axis.dot(region.axis.direction);
    heights.push_back(height);
    radii.push_back((from_axis - height * region.axis.direction).norm());
  }
  region.radius = kRegionMargin * Quantile(std::move(radii), kRegionQuantile);
  region.low = Quantile(heights, 1 - kRegionQuantile);
  region.high = Quantile(std::move(heights), kRegionQuantile);
  const double slack =
      std::max((kRegionMargin - 1) * (region.high - region.low), kRegionSlack * region.radius);
  region.low -= slack;
  region.high += slack;
  return region;
}

}  // namespace s2gs
