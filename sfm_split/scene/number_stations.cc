#include "sfm_split/scene/number_stations.h"

#include <map>

namespace s2gs {

void NumberStations(TurntableScene* scene) {
  std::map<int, int> number_of;
  for (const View& view : scene->views) number_of[view.station] = 0;
  scene->num_stations = 0;
  for (auto& [station, number] : number_of) number = scene->num_stations++;
  for (View& view : scene->views) view.station = number_of.at(view.station);
}

}  // namespace s2gs
