#include "sfm_split/relocalise/silhouette_ties.h"

#include <string>
#include <utility>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/scene/axis_turn.h"
#include "sfm_split/silhouettes/scene_silhouettes.h"
#include "sfm_split/turntable/tied_stations.h"

namespace s2gs {

SilhouetteTies TieBySilhouettes(const ReadGreyPhoto& read, const ScanFeatures& features,
                                const AlignedScene& aligned, const std::set<int>& untold,
                                Reporter& reporter) {
  SilhouetteTies ties;
  ties.aligned = aligned;
  std::vector<int> asked;
  for (const int station : TiedStations(aligned)) {
    if (untold.count(station) > 0) asked.push_back(station);
  }
  if (asked.empty()) return ties;
  std::map<std::string, int> image_of_name;
  for (size_t i = 0; i < features.images.size(); ++i)
    image_of_name[features.images[i].name] = static_cast<int>(i);
  TurntableScene& scene = ties.aligned.scene;
  const int reference = scene.Reference()->station;
  for (const auto& [station, turn] : AskSilhouettes(read, scene, asked, reporter)) {
    if (!turn.is_told) continue;
    StationTurnPrior prior;
    prior.sigma_rad = turn.sigma_rad;
    for (View& view : scene.views) {
      if (view.station == station) {
        view.angle_deg = WrapAngle(view.angle_deg * kDegree + turn.turn_rad) / kDegree;
        view.world_from_object = view.world_from_object * TurnAbout(scene.axis, turn.turn_rad);
      }
      const StationTurnPrior::Place place = {image_of_name.at(view.name), view.angle_deg * kDegree};
      if (view.station == station) prior.second.push_back(place);
      if (view.station == reference) prior.first.push_back(place);
    }
    ties.priors.push_back(std::move(prior));
    ties.sigma_deg[station] = turn.sigma_rad / kDegree;
  }
  return ties;
}

}  // namespace s2gs
