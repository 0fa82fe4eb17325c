#include "sfm_split/turntable/rigged_circle_scene.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>

#include "sfm_split/turntable/axis_sense.h"
#include "sfm_split/turntable/background_cameras.h"

namespace s2gs {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr size_t kMaxMatches = 60;        // of a pair: more say the same again
constexpr double kUniformWidth = 3.4641;  // of a uniform distribution, over its standard deviation
constexpr int kLeastPhotos = 4;           // of a station that can be a turn

struct Place {
  int station = -1;
  int photo = 0;
};

}  // namespace

AlignedScene SceneFromRiggedCircle(const ScanFeatures& features, const ColmapModel& background,
                                   double sigma_px, Reporter& reporter, RiggedCircle* circle) {
  std::map<int, int> num_photos;
  for (const ScanImage& image : features.images) ++num_photos[image.station];
  const std::vector<Camera> cameras = CamerasBeside(features, &background);
  std::map<uint32_t, size_t> camera_of_id;
  for (const auto& [id, camera] : features.cameras) camera_of_id.emplace(id, camera_of_id.size());
  const std::map<int, Rigid3> poses = StationPoses(features, &background);

  std::vector<RiggedStation> stations;
  std::map<int, int> index_of;
  std::vector<Place> places(features.images.size());
  for (size_t i = 0; i < features.images.size(); ++i) {
    const ScanImage& image = features.images[i];
    const auto pose = poses.find(image.station);
    if (pose == poses.end() || num_photos[image.station] < kLeastPhotos) continue;
    const auto [entry, is_new] = index_of.emplace(image.station, static_cast<int>(stations.size()));
    if (is_new) {
      stations.push_back({pose->second, FocalLengths(cameras[camera_of_id.at(image.camera_id)]).mean(), 0});
    }
    places[i] = {entry->second, stations[static_cast<size_t>(entry->second)].num_photos++};
  }
  if (stations.size() < 2) return {};

  std::vector<RiggedPair> pairs;
  Vector2d sum = Vector2d::Zero();
  Vector2d squares = Vector2d::Zero();
  double num = 0;
  const auto ray_of = [&](size_t i, uint32_t keypoint) {
    const Camera& camera = cameras[camera_of_id.at(features.images[i].camera_id)];
    return UnprojectFromImage(camera, features.images[i].keypoints[keypoint].cast<double>());
  };
  for (const ImagePairMatches& given : AllPairs(features)) {
    const auto i = static_cast<size_t>(given.image1);
    const auto j = static_cast<size_t>(given.image2);
    if (places[i].station < 0 || places[j].station < 0) continue;
    RiggedPair pair{places[i].station, places[i].photo, places[j].station, places[j].photo, {}};
    const FeatureMatches matches = PossibleObjectMatches(features, given);
    const size_t stride = matches.size() / kMaxMatches + 1;
    for (size_t m = 0; m < matches.size(); m += stride) {
      const std::optional<Vector3d> first = ray_of(i, matches[m].point2D_idx1);
      const std::optional<Vector3d> second = ray_of(j, matches[m].point2D_idx2);
      if (!first || !second) continue;
      pair.rays.emplace_back(*first, *second);
      const Vector2d xy = features.images[i].keypoints[matches[m].point2D_idx1].cast<double>();
      sum += xy;
      squares += xy.cwiseAbs2();
      num += 1;
    }
    if (!pair.rays.empty()) pairs.push_back(std::move(pair));
  }
  if (num == 0) return {};
  const double spread_px = std::sqrt(std::max(1.0, (squares / num - (sum / num).cwiseAbs2()).mean()));
  *circle = FitRiggedCircle(stations, pairs, kUniformWidth * spread_px, sigma_px, reporter);
  if (!circle->found) return {};
  std::vector<Eigen::Matrix3d> cam_from_world;
  for (const RiggedStation& station : stations)
    cam_from_world.push_back(station.cam_from_world.rotation.toRotationMatrix());
  if (AxisUpSign(circle->axis.direction, cam_from_world) < 0) {
    circle->axis.direction *= -1;
    for (std::vector<double>& angles : circle->angle_rad) {
      for (double& angle : angles) angle = -angle;
    }
  }

  std::vector<PhotoOnTurn> photos;
  size_t reference = 0;
  for (size_t i = 0; i < features.images.size(); ++i) {
    const Place& place = places[i];
    if (place.station < 0) continue;
    if (place.station == 0 && place.photo == 0) reference = photos.size();
    photos.push_back(
        {i, poses.at(features.images[i].station),
         circle->angle_rad[static_cast<size_t>(place.station)][static_cast<size_t>(place.photo)]});
  }
  return SceneAboutAxis(features, &background, circle->axis, photos, reference, /*scale_observable=*/true);
}

}  // namespace s2gs
