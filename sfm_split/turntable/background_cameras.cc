#include "sfm_split/turntable/background_cameras.h"

#include <set>
#include <string>

#include "sfm_split/base/angles.h"
#include "sfm_split/scene/axis_turn.h"

namespace s2gs {

std::map<int, Rigid3> StationPoses(const ScanFeatures& features, const ColmapModel* background) {
  std::map<int, Rigid3> poses;
  if (background != nullptr && !background->images.empty()) {
    std::map<std::string, int> station_of_name;
    for (const ScanImage& image : features.images) station_of_name[image.name] = image.station;
    for (const auto& [id, image] : background->images) {
      const auto found = station_of_name.find(image.name);
      if (found != station_of_name.end()) poses.emplace(found->second, image.cam_from_world);
    }
    return poses;
  }
  const std::map<int, int> sizes = SizesOfStations(features);
  int largest = -1;
  for (const auto& [station, size] : sizes) {
    if (largest < 0 || size > sizes.at(largest)) largest = station;
  }
  if (largest >= 0) poses[largest] = Rigid3();
  return poses;
}

std::vector<Camera> CamerasBeside(const ScanFeatures& features, const ColmapModel* background) {
  std::vector<Camera> cameras;
  for (const auto& [id, given] : features.cameras) {
    const bool is_known = background != nullptr && background->cameras.count(id) > 0;
    cameras.push_back(is_known ? background->cameras.at(id) : given);
  }
  return cameras;
}

AlignedScene SceneAboutAxis(const ScanFeatures& features, const ColmapModel* background,
                            const TurntableAxis& axis, const std::vector<PhotoOnTurn>& photos,
                            size_t reference, bool scale_observable) {
  AlignedScene aligned;
  aligned.solution.motion = TurntableMotion::kRotates;
  aligned.solution.scale_observable = scale_observable;
  TurntableScene& scene = aligned.scene;
  scene.cameras = CamerasBeside(features, background);
  scene.axis = axis;
  scene.scale_observable = scale_observable;
  std::map<int, int> station_number;
  for (size_t k = 0; k < photos.size(); ++k) {
    const ScanImage& image = features.images[photos[k].image];
    View view;
    view.name = image.name;
    view.camera_id = image.camera_id;
    view.station =
        station_number.emplace(image.station, static_cast<int>(station_number.size())).first->second;
    const bool is_reference = k == reference;
    if (is_reference) scene.reference = view.name;
    view.angle_deg = is_reference ? 0 : photos[k].angle_rad / kDegree;
    view.cam_from_world = photos[k].cam_from_world;
    view.world_from_object = TurnAbout(axis, photos[k].angle_rad);
    scene.views.push_back(view);
  }
  scene.num_stations = static_cast<int>(station_number.size());
  if (background != nullptr && !background->images.empty()) {
    aligned.background = *background;
    std::vector<std::string> gone;
    std::set<std::string> kept;
    for (const View& view : scene.views) kept.insert(view.name);
    for (const auto& [id, image] : aligned.background.images) {
      aligned.cam_from_background[image.name] = image.cam_from_world;
      if (kept.count(image.name) == 0) gone.push_back(image.name);
    }
    // Poses of stations stay known through their views; points are triangulated anew.
    if (gone.size() < aligned.background.images.size()) RemoveImages(gone, &aligned.background);
  }
  BringIntoConventions(&aligned);
  return aligned;
}

}  // namespace s2gs
