#include "sfm_split/placement/model_difference.h"

#include <cmath>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {

void WidenByDifference(const TurntableScene& of_photos, const TurntableScene& of_stations,
                       JointReport* joint) {
  const View* const reference = of_stations.Reference();
  if (reference == nullptr || joint->angle_sigma_deg.size() != of_stations.views.size()) return;
  std::map<std::string, double> angle_of;
  for (const View& view : of_photos.views) angle_of[view.name] = view.angle_deg;
  std::map<size_t, double> apart_deg;  // by view
  std::vector<double> at_reference;
  for (size_t v = 0; v < of_stations.views.size(); ++v) {
    const View& view = of_stations.views[v];
    const auto found = angle_of.find(view.name);
    if (found == angle_of.end()) continue;
    apart_deg[v] = WrapAngle((found->second - view.angle_deg) * kDegree) / kDegree;
    if (view.station == reference->station) at_reference.push_back(apart_deg[v]);
  }
  if (at_reference.empty()) return;
  const double origin_deg = UpperMedian(std::move(at_reference));
  for (const auto& [v, apart] : apart_deg) {
    double& sigma_deg = joint->angle_sigma_deg[v];
    if (sigma_deg > 0) sigma_deg = std::hypot(sigma_deg, apart - origin_deg);
  }
  for (size_t c = 0; c < joint->focal_sigma_px.size() && c < of_photos.cameras.size(); ++c) {
    double& sigma_px = joint->focal_sigma_px[c];
    const double apart_px =
        FocalLengths(of_photos.cameras[c]).mean() - FocalLengths(of_stations.cameras[c]).mean();
    if (sigma_px > 0) sigma_px = std::hypot(sigma_px, apart_px);
  }
}

}  // namespace s2gs
