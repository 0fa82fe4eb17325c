#include "sfm_split/single_axis/single_axis_scene.h"

#include <map>

#include "sfm_split/turntable/background_cameras.h"

namespace s2gs {
AlignedScene SceneFromSingleAxis(const ScanFeatures& features, const ColmapModel* background,
                                 const SingleAxisOptions& options, Reporter& reporter,
                                 SingleAxisSolution* solution) {
  const bool has_background = background != nullptr && !background->images.empty();
  const std::map<int, Rigid3> pose_of_station = StationPoses(features, background);
  SingleAxisInput input;
  input.cameras = CamerasBeside(features, background);
  std::map<uint32_t, int> camera_of_id;
  for (const auto& [id, camera] : features.cameras)
    camera_of_id.emplace(id, static_cast<int>(camera_of_id.size()));
  std::vector<int> index_of(features.images.size(), -1);
  std::vector<size_t> image_of;
  for (size_t i = 0; i < features.images.size(); ++i) {
    const ScanImage& image = features.images[i];
    const auto pose = pose_of_station.find(image.station);
    if (pose == pose_of_station.end()) continue;
    index_of[i] = static_cast<int>(input.images.size());
    image_of.push_back(i);
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
  if (!solution->found) return {};
  std::vector<PhotoOnTurn> photos;
  size_t reference = 0;
  for (size_t k = 0; k < input.images.size(); ++k) {
    if (!solution->images[k].found) continue;
    if (static_cast<int>(k) == solution->reference) reference = photos.size();
    photos.push_back({image_of[k], input.images[k].cam_from_world, solution->images[k].angle_rad});
  }
  return SceneAboutAxis(features, background, solution->axis, photos, reference,
                        solution->scale_observable && has_background);
}

}  // namespace s2gs
