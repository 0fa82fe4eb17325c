#include "sfm_split/circular_motion/circular_scene.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <string>
#include <utility>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/circular_motion/circular_search.h"
#include "sfm_split/circular_motion/circular_ties.h"
#include "sfm_split/circular_motion/match_mixture.h"
#include "sfm_split/circular_motion/match_triples.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr size_t kMaxCrossing = 60;  // matches of a pair of photos of two stations

// What a station's keypoints that move say about the object: where it is and how large it looks.
struct Appearance {
  Vector2d middle = Vector2d::Zero();  // in the plane z = 1
  double extent = 0;                   // there; standard deviation
  double extent_px = 0;
};

Appearance AppearanceOf(const CircularStation& station, const Camera& camera) {
  Vector2d sum = Vector2d::Zero();
  Vector2d squares = Vector2d::Zero();
  double num = 0;
  for (const CircularPair& pair : station.pairs) {
    for (const auto& match : pair.matches) {
      for (const Vector2d& xy : {match.first, match.second}) {
        const std::optional<Vector3d> ray = UnprojectFromImage(camera, xy);
        if (!ray) continue;
        sum += ray->head<2>();
        squares += ray->head<2>().cwiseAbs2();
        num += 1;
      }
    }
  }
  Appearance result;
  if (num == 0) return result;
  result.middle = sum / num;
  result.extent = std::sqrt(std::max(1e-12, (squares / num - result.middle.cwiseAbs2()).mean()));
  result.extent_px = result.extent * FocalLengths(camera).mean();
  return result;
}

// A station with its axis as z: the camera at (1, 0, 0).
Matrix3d CamFromAxis(const CircularStationFit& fit) {
  Matrix3d result;
  result << -fit.foot, -fit.axis.cross(fit.foot), fit.axis;
  return result;
}

// Where along the axis, from the camera's height up and over its distance from the axis, the object is seen.
double ObjectHeight(const Matrix3d& cam_from_axis, const Appearance& looks) {
  const Vector3d ray = cam_from_axis.transpose() * Vector3d(looks.middle.x(), looks.middle.y(), 1);
  // Nearest to the axis on the ray from (1, 0, 0).
  const double across = ray.head<2>().squaredNorm();
  return across > 1e-9 ? -ray.x() / across * ray.z() : 0;
}

double DistanceTo(const Matrix3d& cam_from_axis, const Appearance& looks) {
  return std::hypot(1.0, ObjectHeight(cam_from_axis, looks));
}

class SceneBuilder {
 public:
  // \param numbers  of the stations in the features.
  SceneBuilder(const ScanFeatures& features, const CircularMotion& motion, const std::vector<int>& numbers,
               const std::vector<uint32_t>& camera_ids, const std::vector<CircularStation>& stations)
      : features_(features), motion_(motion), camera_ids_(camera_ids), stations_(stations) {
    photos_.resize(features.images.size());
    std::map<int, size_t> index_of;
    for (size_t s = 0; s < numbers.size(); ++s) index_of[numbers[s]] = s;
    std::vector<int> next(numbers.size(), 0);
    for (size_t i = 0; i < features.images.size(); ++i) {
      const auto found = index_of.find(features.images[i].station);
      if (found == index_of.end()) continue;
      photos_[i] = {static_cast<int>(found->second), next[found->second]++};
    }
    for (size_t s = 0; s < stations.size(); ++s) {
      looks_.push_back(AppearanceOf(stations[s], motion.cameras[static_cast<size_t>(stations[s].camera)]));
    }
    places_.resize(stations.size());
  }

  /// Ties stations to each other, the surest first. Returns how many are placed.
  int Place(const Reporter& reporter);
  AlignedScene Build() const;

 private:
  struct Photo {
    int station = -1;
    int place = 0;
  };
  const CircularStationFit& FitOf(size_t station) const { return motion_.stations[station]; }
  bool IsUsed(size_t image) const {
    const Photo& photo = photos_[image];
    return photo.station >= 0 && FitOf(static_cast<size_t>(photo.station)).found &&
           FitOf(static_cast<size_t>(photo.station)).placed[static_cast<size_t>(photo.place)] != 0;
  }
  CircularView ViewOf(size_t image) const {
    const Photo& photo = photos_[image];
    const CircularStationFit& fit = FitOf(static_cast<size_t>(photo.station));
    return {CamFromAxis(fit), fit.angles_rad[static_cast<size_t>(photo.place)]};
  }
  const Camera& CameraOf(size_t image) const {
    const auto at = std::find(camera_ids_.begin(), camera_ids_.end(), features_.images[image].camera_id);
    return motion_.cameras[static_cast<size_t>(at - camera_ids_.begin())];
  }
  std::vector<CrossingPair> CrossingPairs(int station, double chance) const;
  CircularPlace StartOf(int station, int placed) const;

  const ScanFeatures& features_;
  const CircularMotion& motion_;
  const std::vector<uint32_t>& camera_ids_;
  const std::vector<CircularStation>& stations_;
  std::vector<Photo> photos_;  // per image
  std::vector<Appearance> looks_;
  std::vector<std::optional<CircularPlace>> places_;
};

// Matches between a station and all those that are placed.
// \param chance  density of a wrong match's error [1 / px].
std::vector<CrossingPair> SceneBuilder::CrossingPairs(int station, double chance) const {
  std::vector<CrossingPair> result;
  for (const ImagePairMatches& given : AllPairs(features_)) {
    const auto i = static_cast<size_t>(given.image1);
    const auto j = static_cast<size_t>(given.image2);
    if (!IsUsed(i) || !IsUsed(j)) continue;
    const bool is_first = photos_[i].station == station;
    const size_t mine = is_first ? i : j;
    const size_t other = is_first ? j : i;
    if (photos_[mine].station != station || photos_[other].station == station) continue;
    const std::optional<CircularPlace>& place = places_[static_cast<size_t>(photos_[other].station)];
    if (!place) continue;
    CrossingPair pair;
    pair.cam_from_object = CamFromObject(ViewOf(other), *place);
    pair.view = ViewOf(mine);
    pair.placed_focal_px = FocalLengths(CameraOf(other)).mean();
    pair.focal_px = FocalLengths(CameraOf(mine)).mean();
    for (const FeatureMatch& match : given.matches) {
      const uint32_t k = is_first ? match.point2D_idx1 : match.point2D_idx2;
      const uint32_t l = is_first ? match.point2D_idx2 : match.point2D_idx1;
      if (IsStatic(features_.images[mine], k) || IsStatic(features_.images[other], l)) continue;
      const std::optional<Vector3d> ray =
          UnprojectFromImage(CameraOf(mine), features_.images[mine].keypoints[k].cast<double>());
      const std::optional<Vector3d> other_ray =
          UnprojectFromImage(CameraOf(other), features_.images[other].keypoints[l].cast<double>());
      if (ray && other_ray && pair.matches.size() < kMaxCrossing)
        pair.matches.push_back({*other_ray, *ray, chance});
    }
    if (!pair.matches.empty()) result.push_back(std::move(pair));
  }
  return result;
}

// The object looks as large as it is, and stands where it stands.
CircularPlace SceneBuilder::StartOf(int station, int placed) const {
  const auto s = static_cast<size_t>(station);
  const auto p = static_cast<size_t>(placed);
  const Matrix3d mine = CamFromAxis(FitOf(s));
  const Matrix3d other = CamFromAxis(FitOf(p));
  CircularPlace start;
  start.distance = places_[p]->distance * looks_[p].extent * DistanceTo(other, looks_[p]) /
                   (looks_[s].extent * DistanceTo(mine, looks_[s]));
  const double object_z = places_[p]->height + places_[p]->distance * ObjectHeight(other, looks_[p]);
  start.height = object_z - start.distance * ObjectHeight(mine, looks_[s]);
  return start;
}

int SceneBuilder::Place(const Reporter& reporter) {
  int root = -1;
  for (size_t s = 0; s < places_.size(); ++s) {
    if (FitOf(s).found && (root < 0 || FitOf(s).gain > FitOf(static_cast<size_t>(root)).gain))
      root = static_cast<int>(s);
  }
  if (root < 0) return 0;
  places_[static_cast<size_t>(root)] = CircularPlace();
  int placed = 1;
  for (bool has_placed = true; has_placed;) {
    has_placed = false;
    int best = -1;
    CircularTie best_tie;
    for (size_t s = 0; s < places_.size(); ++s) {
      if (places_[s] || !FitOf(s).found) continue;
      if (reporter.StopRequested()) throw Interrupted();
      const double extent_px = 0.5 * (looks_[s].extent_px + looks_[static_cast<size_t>(root)].extent_px);
      const std::vector<CrossingPair> pairs =
          CrossingPairs(static_cast<int>(s), 1 / (kUniformWidth * extent_px));
      if (pairs.empty()) continue;
      const CircularTie tie = TieCircularStation(pairs, StartOf(static_cast<int>(s), root), motion_.sigma_px);
      if (!tie.found || tie.gain <= best_tie.gain) continue;
      best = static_cast<int>(s);
      best_tie = tie;
    }
    if (best < 0) break;
    places_[static_cast<size_t>(best)] = best_tie.place;
    ++placed;
    has_placed = true;
  }
  return placed;
}

AlignedScene SceneBuilder::Build() const {
  AlignedScene aligned;
  aligned.solution.motion = TurntableMotion::kRotates;
  TurntableScene& scene = aligned.scene;
  scene.cameras = motion_.cameras;
  std::map<int, int> number_of;
  std::optional<double> zero;
  for (size_t i = 0; i < features_.images.size(); ++i) {
    if (!IsUsed(i) || !places_[static_cast<size_t>(photos_[i].station)]) continue;
    const ScanImage& image = features_.images[i];
    const CircularPlace& place = *places_[static_cast<size_t>(photos_[i].station)];
    const CircularView of_photo = ViewOf(i);
    // The object's frame is the world's at the first photo of all.
    if (!zero) zero = of_photo.angle_rad + place.turn_rad;
    View view;
    view.name = image.name;
    view.camera_id = image.camera_id;
    view.station = number_of.emplace(image.station, static_cast<int>(number_of.size())).first->second;
    const Rigid3 cam_from_object = CamFromObject(of_photo, place);
    const Matrix3d back = RotationAbout<double>(Vector3d::UnitZ(), -*zero);
    const Rigid3 cam_from_first = cam_from_object * Rigid3{Eigen::Quaterniond(back), Vector3d::Zero()};
    const auto first_of_station = std::find_if(scene.views.begin(), scene.views.end(),
                                               [&](const View& v) { return v.station == view.station; });
    if (first_of_station == scene.views.end()) {
      view.cam_from_world = cam_from_first;
    } else {
      view.cam_from_world = first_of_station->cam_from_world;
      const Rigid3 world_from_object = view.cam_from_world.Inverse() * cam_from_first;
      const double angle = AngleAbout(Vector3d::UnitZ(), world_from_object.rotation.toRotationMatrix());
      view.angle_deg = angle / kDegree;
      view.world_from_object = {Eigen::Quaterniond(RotationAbout<double>(Vector3d::UnitZ(), angle)),
                                Vector3d::Zero()};
    }
    scene.views.push_back(view);
  }
  scene.num_stations = static_cast<int>(number_of.size());
  if (!scene.views.empty()) BringIntoConventions(&aligned);
  return aligned;
}

}  // namespace

std::vector<CircularStation> CollectCircularStations(const ScanFeatures& features,
                                                     const std::vector<uint32_t>& cameras,
                                                     std::vector<int>* numbers) {
  std::vector<CircularStation> stations;
  std::map<int, size_t> index_of;
  std::vector<int> place(features.images.size(), 0);
  std::vector<char> is_mixed;
  numbers->clear();
  for (size_t i = 0; i < features.images.size(); ++i) {
    const ScanImage& image = features.images[i];
    const auto camera =
        static_cast<int>(std::find(cameras.begin(), cameras.end(), image.camera_id) - cameras.begin());
    const auto [entry, is_new] = index_of.emplace(image.station, stations.size());
    if (is_new) {
      stations.emplace_back();
      stations.back().camera = camera;
      numbers->push_back(image.station);
      is_mixed.push_back(0);
    }
    CircularStation& station = stations[entry->second];
    if (station.camera != camera) is_mixed[entry->second] = 1;
    place[i] = station.num_photos++;
  }
  for (const ImagePairMatches& given : AllPairs(features)) {
    const ScanImage& first = features.images[static_cast<size_t>(given.image1)];
    const ScanImage& second = features.images[static_cast<size_t>(given.image2)];
    if (first.station != second.station) continue;
    const size_t s = index_of.at(first.station);
    if (is_mixed[s] != 0) continue;
    CircularPair pair;
    pair.photo1 = place[static_cast<size_t>(given.image1)];
    pair.photo2 = place[static_cast<size_t>(given.image2)];
    for (const FeatureMatch& match : PossibleObjectMatches(features, given)) {
      pair.matches.emplace_back(first.keypoints[match.point2D_idx1].cast<double>(),
                                second.keypoints[match.point2D_idx2].cast<double>());
    }
    if (!pair.matches.empty()) stations[s].pairs.push_back(std::move(pair));
  }
  for (const PhotoTriple& given : PhotoTriples(features)) {
    const size_t s = index_of.at(given.station);
    if (is_mixed[s] != 0) continue;
    CircularRow row{given.places, {}};
    for (const MatchTriple& match : given.matches) row.triples.push_back(KeypointsOf(features, given, match));
    stations[s].rows.push_back(std::move(row));
  }
  return stations;
}

AlignedScene SceneFromCircularMotion(const ScanFeatures& features, const CircularOptions& options,
                                     Reporter& reporter, CircularFinding* finding) {
  if (options.begun != nullptr && options.begun->IsOf(features))
    return options.begun->Await(reporter, finding);
  std::vector<uint32_t> camera_ids;
  std::vector<Camera> cameras;
  std::vector<FocalPrior> priors;
  for (const auto& [id, camera] : features.cameras) {
    camera_ids.push_back(id);
    cameras.push_back(camera);
    if (InfoOf(camera.model).num_focal_params == 0) return {};
    priors.push_back(FocalPriorOf(camera, HasPriorFocal(features, id)));
  }
  const std::vector<CircularStation> stations =
      CollectCircularStations(features, camera_ids, &finding->stations);
  finding->motion = FitCircularMotion(stations, cameras, priors, options, reporter);
  for (CircularMotion& motion : std::exchange(finding->motion.rivals, {})) {
    CircularRival rival;
    rival.motion = std::move(motion);
    SceneBuilder builder(features, rival.motion, finding->stations, camera_ids, stations);
    rival.placed_stations = builder.Place(reporter);
    if (rival.placed_stations == 0) continue;
    rival.aligned = builder.Build();
    finding->rivals.push_back(std::move(rival));
  }
  SceneBuilder builder(features, finding->motion, finding->stations, camera_ids, stations);
  finding->placed_stations = builder.Place(reporter);
  if (finding->placed_stations == 0) return {};
  return builder.Build();
}

}  // namespace s2gs
