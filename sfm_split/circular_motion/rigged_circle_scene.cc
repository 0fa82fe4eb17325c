#include "sfm_split/circular_motion/rigged_circle_scene.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "sfm_split/circular_motion/match_mixture.h"
#include "sfm_split/circular_motion/rigged_circle.h"
#include "sfm_split/turntable/axis_sense.h"
#include "sfm_split/turntable/background_cameras.h"

namespace s2gs {
namespace {

using Eigen::Vector3d;

constexpr int kLeastPhotos = 4;  // of a station that can be a turn

struct Place {
  int station = -1;  // index into Rig::stations; -1: the background does not know it
  int photo = 0;
};

struct Rig {
  std::vector<RiggedStation> stations;
  std::vector<Place> places;  // per image of the features
  std::vector<RiggedPair> pairs;
  double extent_px = 0;  // of what the matches lie on
};

class RigCollector {
 public:
  RigCollector(const ScanFeatures& features, const ColmapModel& background)
      : features_(features),
        cameras_(CamerasBeside(features, &background)),
        poses_(StationPoses(features, &background)) {
    for (const auto& [id, camera] : features.cameras) camera_of_id_.emplace(id, camera_of_id_.size());
  }

  Rig Collect(const std::vector<PossiblePair>& possible) const {
    Rig rig;
    PlaceStations(&rig);
    if (rig.stations.size() >= 2) CollectPairs(possible, &rig);
    return rig;
  }

 private:
  const Camera& CameraOf(size_t image) const {
    return cameras_[camera_of_id_.at(features_.images[image].camera_id)];
  }

  void PlaceStations(Rig* rig) const {
    const std::map<int, int> num_photos = SizesOfStations(features_);
    std::map<int, int> index_of;
    rig->places.resize(features_.images.size());
    for (size_t i = 0; i < features_.images.size(); ++i) {
      const int station = features_.images[i].station;
      const auto pose = poses_.find(station);
      if (pose == poses_.end() || num_photos.at(station) < kLeastPhotos) continue;
      const auto [entry, is_new] = index_of.emplace(station, static_cast<int>(rig->stations.size()));
      if (is_new) rig->stations.push_back({pose->second, FocalLengths(CameraOf(i)).mean(), 0});
      rig->places[i] = {entry->second, rig->stations[static_cast<size_t>(entry->second)].num_photos++};
    }
  }

  void CollectPairs(const std::vector<PossiblePair>& possible, Rig* rig) const {
    KeypointExtent extent;
    for (const PossiblePair& given : possible) {
      const auto i = static_cast<size_t>(given.image1);
      const auto j = static_cast<size_t>(given.image2);
      const Place& first = rig->places[i];
      const Place& second = rig->places[j];
      if (first.station < 0 || second.station < 0) continue;
      RiggedPair pair{first.station, first.photo, second.station, second.photo, {}};
      for (size_t m = 0; m < given.matches.size(); ++m) {
        const Eigen::Vector2d xy1 =
            features_.images[i].keypoints[given.matches[m].point2D_idx1].cast<double>();
        const Eigen::Vector2d xy2 =
            features_.images[j].keypoints[given.matches[m].point2D_idx2].cast<double>();
        const std::optional<Vector3d> ray1 = UnprojectFromImage(CameraOf(i), xy1);
        const std::optional<Vector3d> ray2 = UnprojectFromImage(CameraOf(j), xy2);
        if (!ray1 || !ray2) continue;
        pair.matches.push_back({*ray1, *ray2, given.chance[m]});
        extent.Add(xy1);
        extent.Add(xy2);
      }
      if (!pair.matches.empty()) rig->pairs.push_back(std::move(pair));
    }
    rig->extent_px = extent.Px();
  }

  const ScanFeatures& features_;
  std::vector<Camera> cameras_;
  std::map<uint32_t, size_t> camera_of_id_;
  std::map<int, Rigid3> poses_;
};

// About the axis that points to where the cameras look down from.
void PointAxisUp(const std::vector<RiggedStation>& stations, RiggedCircle* circle) {
  std::vector<Eigen::Matrix3d> cam_from_world;
  cam_from_world.reserve(stations.size());
  for (const RiggedStation& station : stations)
    cam_from_world.push_back(station.cam_from_world.rotation.toRotationMatrix());
  if (AxisUpSign(circle->axis.direction, cam_from_world) > 0) return;
  circle->axis.direction *= -1;
  for (std::vector<double>& angles : circle->angle_rad) {
    for (double& angle : angles) angle = -angle;
  }
}

}  // namespace

std::vector<AlignedScene> ScenesFromRiggedCircles(const ScanFeatures& features,
                                                  const std::vector<PossiblePair>& object_pairs,
                                                  const ColmapModel& background, double sigma_px,
                                                  Reporter& reporter) {
  const Rig rig = RigCollector(features, background).Collect(object_pairs);
  if (rig.pairs.empty()) return {};
  std::vector<AlignedScene> scenes;
  for (RiggedCircle& circle : FitRiggedCircles(rig.stations, rig.pairs, rig.extent_px, sigma_px, reporter)) {
    PointAxisUp(rig.stations, &circle);
    std::vector<PhotoOnTurn> photos;
    size_t reference = 0;
    for (size_t i = 0; i < features.images.size(); ++i) {
      const Place& place = rig.places[i];
      if (place.station < 0) continue;
      const auto s = static_cast<size_t>(place.station);
      if (place.station == 0 && place.photo == 0) reference = photos.size();
      photos.push_back(
          {i, rig.stations[s].cam_from_world, circle.angle_rad[s][static_cast<size_t>(place.photo)]});
    }
    reporter.Debug("circle through the background's cameras: log-likelihood " + std::to_string(circle.gain));
    scenes.push_back(
        SceneAboutAxis(features, &background, circle.axis, photos, reference, /*scale_observable=*/true));
  }
  return scenes;
}

}  // namespace s2gs
