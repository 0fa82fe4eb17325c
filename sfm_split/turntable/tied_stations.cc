#include "sfm_split/turntable/tied_stations.h"

#include <cstdint>
#include <map>
#include <optional>
#include <string>

#include "sfm_split/base/union_find.h"

namespace s2gs {

namespace {

UnionFind TieByBackground(const AlignedScene& aligned) {
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
  return tied;
}

}  // namespace

std::set<int> TiedStations(const AlignedScene& aligned) {
  UnionFind tied = TieByBackground(aligned);
  std::set<int> stations;
  const auto root = tied.Root(static_cast<uint32_t>(aligned.scene.Reference()->station));
  for (int s = 0; s < aligned.scene.num_stations; ++s) {
    if (tied.Root(static_cast<uint32_t>(s)) == root) stations.insert(s);
  }
  return stations.size() > 1 ? stations : std::set<int>();
}

std::vector<std::vector<int>> SetsOfTiedStations(const AlignedScene& aligned) {
  UnionFind tied = TieByBackground(aligned);
  std::vector<std::vector<int>> sets;
  std::map<uint32_t, size_t> set_of_root;
  for (int s = 0; s < aligned.scene.num_stations; ++s) {
    const auto [found, is_new] = set_of_root.emplace(tied.Root(static_cast<uint32_t>(s)), sets.size());
    if (is_new) sets.emplace_back();
    sets[found->second].push_back(s);
  }
  return sets;
}

}  // namespace s2gs
