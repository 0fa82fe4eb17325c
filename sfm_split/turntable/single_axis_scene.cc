#include "sfm_split/turntable/single_axis_scene.h"

#include <Eigen/Geometry>
#include <cmath>
#include <map>
#include <set>

#include "sfm_split/base/angles.h"

namespace s2gs {
namespace {

// Camera pose by station: that of its first image in the background's model.
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
  std::map<int, int> sizes;
  for (const ScanImage& image : features.images) ++sizes[image.station];
  int largest = -1;
  for (const auto& [station, size] : sizes) {
    if (largest < 0 || size > sizes[largest]) largest = station;
  }
  if (largest >= 0) poses[largest] = Rigid3();
  return poses;
}

}  // namespace

AlignedScene SceneFromSingleAxis(const ScanFeatures& features, const ColmapModel* background,
                                 const SingleAxisOptions& options, Reporter& reporter,
                                 SingleAxisSolution* solution) {
  AlignedScene aligned;
  const bool has_background = background != nullptr && !background->images.empty();
  const std::map<int, Rigid3> pose_of_station = StationPoses(features, background);
  SingleAxisInput input;
  std::map<uint32_t, int> camera_of_id;
  for (const auto& [id, given] : features.cameras) {
    Camera camera = given;
    if (has_background && background->cameras.count(id) > 0) camera = background->cameras.at(id);
    camera_of_id[id] = static_cast<int>(input.cameras.size());
    input.cameras.push_back(camera);
  }
  std::vector<int> index_of(features.images.size(), -1);
  std::vector<int> image_of;
  for (size_t i = 0; i < features.images.size(); ++i) {
    const ScanImage& image = features.images[i];
    const auto pose = pose_of_station.find(image.station);
    if (pose == pose_of_station.end()) continue;
    index_of[i] = static_cast<int>(input.images.size());
    image_of.push_back(static_cast<int>(i));
    input.images.push_back({image.name, camera_of_id.at(image.camera_id), image.station, pose->second});
  }
  for (const ImagePairMatches& given : features.object_pairs) {
    const auto i = static_cast<size_t>(given.image1);
    const auto j = static_cast<size_t>(given.image2);
    if (index_of[i] < 0 || index_of[j] < 0) continue;
    SingleAxisPair pair;
    pair.image1 = index_of[i];
    pair.image2 = index_of[j];
    pair.matches.reserve(given.matches.size());
    for (const FeatureMatch& match : given.matches) {
      pair.matches.emplace_back(features.images[i].keypoints[match.point2D_idx1].cast<double>(),
                                features.images[j].keypoints[match.point2D_idx2].cast<double>());
    }
    input.pairs.push_back(std::move(pair));
  }
  *solution = SolveSingleAxis(input, options, reporter);
  if (!solution->found) return aligned;

  aligned.solution.motion = TurntableMotion::kRotates;
  aligned.solution.scale_observable = solution->scale_observable && has_background;
  TurntableScene& scene = aligned.scene;
  scene.cameras = input.cameras;
  scene.axis = solution->axis;
  scene.scale_observable = aligned.solution.scale_observable;
  std::map<int, int> station_number;
  for (size_t k = 0; k < input.images.size(); ++k) {
    if (!solution->images[k].found) continue;
    const ScanImage& image = features.images[static_cast<size_t>(image_of[k])];
    View view;
    view.name = image.name;
    view.camera_id = image.camera_id;
    view.station =
        station_number.emplace(image.station, static_cast<int>(station_number.size())).first->second;
    const bool is_reference = static_cast<int>(k) == solution->reference;
    if (is_reference) scene.reference = view.name;
    view.angle_deg = is_reference ? 0 : solution->images[k].angle_rad / kDegree;
    view.cam_from_world = input.images[k].cam_from_world;
    view.world_from_object = solution->WorldFromObject(static_cast<int>(k));
    scene.views.push_back(view);
  }
  scene.num_stations = static_cast<int>(station_number.size());
  if (has_background) {
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
