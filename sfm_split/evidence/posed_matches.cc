#include "sfm_split/evidence/posed_matches.h"

#include <algorithm>
#include <map>
#include <string>

namespace s2gs {

PosedMatches::PosedMatches(const ScanFeatures& features, const TurntableScene& scene, double bound_px,
                           ScanPart part)
    : features_(features),
      bound_px_(bound_px),
      posed_(features.images.size()),
      view_of_(features.images.size()) {
  std::map<uint32_t, const Camera*> cameras;
  for (const Camera& camera : scene.cameras) cameras[camera.camera_id] = &camera;
  std::map<std::string, const View*> views;
  for (const View& view : scene.views) views[view.name] = &view;
  for (size_t i = 0; i < features.images.size(); ++i) {
    const auto found = views.find(features.images[i].name);
    if (found == views.end()) continue;
    const View& view = *found->second;
    view_of_[i] = &view;
    posed_[i] = {true, cameras.at(view.camera_id),
                 part == ScanPart::kObject ? view.CamFromObject() : view.cam_from_world};
  }
  errors_.emplace(posed_, AllKeypoints(features));
}

AgreeingMatches PosedMatches::Compare(const ImagePairMatches& pair, const FeatureMatches& matches,
                                      double bound_px) const {
  AgreeingMatches result;
  result.all = static_cast<int64_t>(matches.size());
  const auto num_within = [&](const FeatureMatches& of) {
    const std::vector<double> errors = ErrorsOf(pair, of);
    return std::count_if(errors.begin(), errors.end(), [&](double error) { return error <= bound_px; });
  };
  result.agreeing = num_within(matches);
  const size_t away = matches.size() / 2;
  if (away == 0) return result;
  FeatureMatches exchanged = matches;
  for (size_t m = 0; m < matches.size(); ++m)
    exchanged[m].point2D_idx2 = matches[(m + away) % matches.size()].point2D_idx2;
  result.by_chance = static_cast<double>(num_within(exchanged));
  return result;
}

}  // namespace s2gs
