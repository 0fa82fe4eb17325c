#include "plugin/outputs/grey_photos.h"

#include <map>
#include <string>

#include "plugin/outputs/photo_gains.h"
#include "plugin/outputs/photo_turns.h"

namespace s2gs {

Image8 GreyPhotos::LoadPlaneSeen(int index) const {
  return seen_height_ ? photos_.LoadTableSeen(index) : Image8();
}

Eigen::Matrix3d GreyPhotos::WorldFromObject(int index) const {
  return turns_.empty() ? Eigen::Matrix3d::Identity() : turns_[index];
}

void GreyPhotos::FindGains(const std::vector<int>& stations, int num_threads) {
  gains_ = GreyGains(photos_, stations, num_threads);
}

void GreyPhotos::SetTurns(const Workspace& workspace, const std::vector<DenseViewFiles>& files) {
  const PhotoTurns turns(workspace, files);
  for (const DenseViewFiles& view : files) {
    if (!view.image.empty()) turns_.push_back(turns.Of(view.name));
  }
}

std::vector<int> StationsOf(const std::optional<TurntableFile>& table,
                            const std::vector<DenseViewFiles>& files) {
  std::map<std::string, int> station_of;
  if (table) {
    for (const TurntableImage& image : table->images) station_of[image.name] = image.station;
  }
  std::vector<int> stations;
  for (const DenseViewFiles& view : files) {
    if (view.image.empty()) continue;
    const auto found = station_of.find(view.name);
    stations.push_back(found == station_of.end() ? -1 : found->second);
  }
  return stations;
}

}  // namespace s2gs
