#include "sfm_split/relocalise/silhouette_ties.h"

#include <cstdint>
#include <optional>
#include <string>
#include <utility>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/base/union_find.h"
#include "sfm_split/scene/axis_turn.h"
#include "sfm_split/silhouettes/scene_silhouettes.h"

namespace s2gs {
namespace {

// Stations that see background points of the reference's, by themselves or by others in between.
std::set<int> TiedByBackground(const AlignedScene& aligned) {
  std::map<std::string, int> station_of_name;
  for (const View& view : aligned.scene.views) station_of_name[view.name] = view.station;
  std::map<uint32_t, int> station_of_image;
  for (const auto& [id, image] : aligned.background.images) {
    const auto found = station_of_name.find(image.name);
    if (found != station_of_name.end()) station_of_image[id] = found->second;
  }
  UnionFind tied(static_cast<size_t>(aligned.scene.num_stations));
  for (const auto& [id, point] : aligned.background.points3D) {
    std::optional<int> first;
    for (const ColmapTrackElement& element : point.track) {
      const auto found = station_of_image.find(element.image_id);
      if (found == station_of_image.end()) continue;
      if (first) tied.Join(static_cast<uint32_t>(*first), static_cast<uint32_t>(found->second));
      first = found->second;
    }
  }
  std::set<int> stations;
  const auto root = tied.Root(static_cast<uint32_t>(aligned.scene.Reference()->station));
  for (int s = 0; s < aligned.scene.num_stations; ++s) {
    if (tied.Root(static_cast<uint32_t>(s)) == root) stations.insert(s);
  }
  return stations;
}

}  // namespace

SilhouetteTies TieBySilhouettes(const ReadGreyPhoto& read, const ScanFeatures& features,
                                const AlignedScene& aligned, const std::set<int>& untold,
                                Reporter& reporter) {
  SilhouetteTies ties;
  ties.aligned = aligned;
  std::vector<int> asked;
  for (const int station : TiedByBackground(aligned)) {
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
