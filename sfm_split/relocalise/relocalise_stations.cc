#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/joint_system/joint_problem.h"
#include "sfm_split/relocalise/scan_refiner.h"
#include "sfm_split/scene/axis_turn.h"

namespace s2gs {
namespace {

constexpr int kMaxBasesOfStation = 4;        // images that are tried as a lost station's first
constexpr int kMinStationVotes = 20;         // matches of two stations that may contradict them
constexpr double kContradictedShare = 0.25;  // of the share that agrees inside stations
constexpr size_t kMaxTiedStations = 24;      // more are a camera held by hand
}  // namespace

// A station that has no view yet: the object's reconstruction places its first image, at table angle 0 by
// definition, or where the background's points say.
int ScanRefiner::NewStation() const {
  int last = -1;
  for (const View& view : aligned_->scene.views) last = std::max(last, view.station);
  return last + 1;
}

bool ScanRefiner::RelocaliseStationByObject(const std::vector<int>& images, double max_error_px) {
  if (object_ == nullptr || object_->images.empty()) return false;
  int tried = 0;
  for (const int base : images) {
    const auto found = object_->images.find(features_.images[static_cast<size_t>(base)].image_id);
    if (found == object_->images.end() ||
        found->second.name != features_.images[static_cast<size_t>(base)].name) {
      continue;
    }
    if (++tried > kMaxBasesOfStation) return false;
    const Rigid3 cam_from_object = TransformPose(aligned_->aligned_from_object, found->second.cam_from_world);
    const std::vector<PointInImage> points =
        PointsSeenBy(base, features_, features_.object_pairs, object_points_);
    PosedImage posed;
    posed.is_posed = true;
    posed.camera = &CameraOf(base);
    posed.cam_from_body = cam_from_object;
    int inliers = 0;
    for (const PointInImage& point : points) {
      inliers += ReprojectionErrorPx(posed, point.x_in_object, point.xy) <= max_error_px ? 1 : 0;
    }
    if (inliers < options_.min_relocalise_inliers ||
        inliers < options_.min_relocalise_share * static_cast<double>(points.size())) {
      continue;
    }
    AddView(base, NewStation(), cam_from_object, Rigid3(), 0);
    report_.relocalised.push_back({features_.images[static_cast<size_t>(base)].name,
                                   "its station was placed by the object alone", inliers,
                                   static_cast<int>(points.size()), 0});
    return true;
  }
  return false;
}

void ScanRefiner::RelocaliseStation(const std::vector<int>& images, double max_error_px) {
  if (RelocaliseStationByObject(images, max_error_px)) return;
  // Where the background's reconstruction has one of its photos, another may show enough of the object.
  for (const int base : images) {
    const auto found = aligned_->cam_from_background.find(features_.images[static_cast<size_t>(base)].name);
    if (found == aligned_->cam_from_background.end()) continue;
    const Rigid3 cam_from_world = TransformPose(aligned_->aligned_from_background, found->second);
    const int station = NewStation();
    for (const int image : images) {
      if (RelocaliseImage(image, cam_from_world, station, max_error_px)) return;
    }
    break;
  }
  RelocaliseStationByPoints(images, max_error_px);
}

// Each photo tells by the object's points where its camera stands against the axis. A station is believed
// where two photos say the same, or one and the background's reconstruction.
void ScanRefiner::RelocaliseStationByPoints(const std::vector<int>& images, double max_error_px) {
  std::vector<std::pair<int, PoseByPoints>> poses;
  poses.reserve(images.size());
  for (const int image : images) {
    if (const std::optional<PoseByPoints> pose = PoseFromPoints(image, max_error_px))
      poses.emplace_back(image, *pose);
  }
  std::stable_sort(poses.begin(), poses.end(),
                   [](const auto& a, const auto& b) { return a.second.inliers > b.second.inliers; });
  View there;
  there.station = NewStation();
  for (const int image : images) {
    const auto found = aligned_->cam_from_background.find(features_.images[static_cast<size_t>(image)].name);
    if (found == aligned_->cam_from_background.end()) continue;
    there.cam_from_world = TransformPose(aligned_->aligned_from_background, found->second);
    for (const auto& [posed, pose] : poses) {
      if (RelocaliseByPose(posed, there, pose)) return;
    }
  }
  for (size_t first = 0; first < poses.size(); ++first) {
    there.cam_from_world = poses[first].second.cam_from_object;
    for (size_t second = first + 1; second < poses.size(); ++second) {
      if (!RelocaliseByPose(poses[second].first, there, poses[second].second)) continue;
      RelocaliseByPose(poses[first].first, there, poses[first].second);
      return;
    }
  }
}

// A station may be wrong as a whole, as where perspective is too weak to tell a view from its mirror image:
// its own photos agree then. It goes where the object's matches contradict it against every station that it
// shares any with, while others agree with each other.
void ScanRefiner::DropContradictedStations(double max_error_px) {
  struct Votes {
    int agree = 0;
    int all = 0;
  };
  std::map<std::pair<int, int>, Votes> votes;  // by two stations
  Votes within;
  const std::vector<std::vector<double>> errors = ErrorsOf(features_.object_pairs);
  for (size_t p = 0; p < errors.size(); ++p) {
    if (errors[p].empty()) continue;
    const ImagePairMatches& pair = features_.object_pairs[p];
    const std::pair<int, int> stations = std::minmax({StationOf(pair.image1), StationOf(pair.image2)});
    Votes& of_pair = stations.first == stations.second ? within : votes[stations];
    for (const double error_px : errors[p]) of_pair.agree += error_px <= max_error_px ? 1 : 0;
    of_pair.all += static_cast<int>(errors[p].size());
  }
  if (within.agree == 0) return;
  const double usual = within.agree / static_cast<double>(within.all);
  std::set<int> agreeing;
  std::set<int> contradicted;
  for (const auto& [stations, of_pair] : votes) {
    if (of_pair.all < kMinStationVotes) continue;
    const bool agrees = of_pair.agree >= kContradictedShare * usual * of_pair.all;
    (agrees ? agreeing : contradicted).insert({stations.first, stations.second});
  }
  std::set<std::string> gone;
  for (size_t i = 0; i < view_of_image_.size(); ++i) {
    const int station = StationOf(static_cast<int>(i));
    if (view_of_image_[i] >= 0 && contradicted.count(station) > 0 && agreeing.count(station) == 0)
      gone.insert(features_.images[i].name);
  }
  if (agreeing.empty()) return;
  TakeOut(gone);
}

// Matches on the background, each photo where it or its station stands.
std::vector<StationMatches> ScanRefiner::MatchesOfStations() const {
  const std::vector<int> views = ViewsOfCameras();
  const auto pose = [&](int image) -> const Rigid3* {
    const int view = views[static_cast<size_t>(image)];
    return view < 0 ? nullptr : &aligned_->scene.views[static_cast<size_t>(view)].cam_from_world;
  };
  std::map<std::pair<int, int>, StationMatches> by_stations;
  std::map<std::pair<int, int>, StationMatches> raw_by_stations;
  const auto add = [&](const ImagePairMatches& pair, bool are_verified) {
    int i = pair.image1;
    int j = pair.image2;
    const bool is_swapped = StationOf(i) > StationOf(j);
    if (is_swapped) std::swap(i, j);
    const Rigid3* first = pose(i);
    const Rigid3* second = pose(j);
    if (StationOf(i) == StationOf(j) || first == nullptr || second == nullptr) return;
    StationMatches& all = (are_verified ? by_stations : raw_by_stations)[{StationOf(i), StationOf(j)}];
    all.are_verified = are_verified;
    all.station = StationOf(i);
    all.other_station = StationOf(j);
    for (const FeatureMatch& match : pair.matches) {
      const uint32_t of_first = is_swapped ? match.point2D_idx2 : match.point2D_idx1;
      const uint32_t of_second = is_swapped ? match.point2D_idx1 : match.point2D_idx2;
      all.matches.push_back({&CameraOf(i), *first,
                             keypoints_[static_cast<size_t>(i)][of_first].cast<double>(), &CameraOf(j),
                             *second, keypoints_[static_cast<size_t>(j)][of_second].cast<double>()});
    }
  };
  for (const ImagePairMatches& pair : features_.static_pairs) add(pair, true);
  for (const ImagePairMatches& pair : features_.raw_static_pairs) add(pair, false);
  std::vector<StationMatches> result;
  result.reserve(by_stations.size() + raw_by_stations.size());
  for (auto& [stations, matches] : by_stations) result.push_back(std::move(matches));
  for (auto& [stations, matches] : raw_by_stations) result.push_back(std::move(matches));
  return result;
}

void ScanRefiner::TurnStation(int station, double turn_rad, const RelocalisedImage& how) {
  const std::string* name = nullptr;
  for (size_t i = 0; i < view_of_image_.size(); ++i) {
    if (view_of_image_[i] < 0 || StationOf(static_cast<int>(i)) != station) continue;
    View& view = aligned_->scene.views[static_cast<size_t>(view_of_image_[i])];
    TurnView(aligned_->scene.axis, turn_rad, &view);
    if (name == nullptr) name = &view.name;
  }
  if (name == nullptr) return;
  turned_stations_[station] = how;
  turned_stations_[station].name = *name;
}

// The turn about the axis between where a station stands and where the background's reconstruction has it, if
// that agrees with the object on the rest of the camera's pose.
std::optional<double> ScanRefiner::TurnFromReconstruction(int station) const {
  const TurntableAxis& axis = aligned_->scene.axis;
  for (size_t i = 0; i < view_of_image_.size(); ++i) {
    if (view_of_image_[i] < 0 || StationOf(static_cast<int>(i)) != station) continue;
    const auto found = aligned_->cam_from_background.find(features_.images[i].name);
    if (found == aligned_->cam_from_background.end()) continue;
    const View& view = aligned_->scene.views[static_cast<size_t>(view_of_image_[i])];
    const Rigid3 there = TransformPose(aligned_->aligned_from_background, found->second);
    const double turn_rad = AngleAboutAxis(axis, CameraCentre(there), CameraCentre(view.cam_from_world));
    const Rigid3 turned = view.cam_from_world * TurnAbout(axis, turn_rad);
    if (AreCamerasClose(axis, turned, there, kMaxCameraMisfit)) return turn_rad;
  }
  return std::nullopt;
}

// Stations that matches do not tie to those placed stand to these as the background's reconstruction has it,
// unless there are enough matches and they contradict it.
void ScanRefiner::PlaceByReconstruction(const std::set<int>& stations, const TieOptions& options) {
  const TurntableAxis& axis = aligned_->scene.axis;
  std::vector<double> turns;
  for (const int station : placed_stations_) {
    if (const std::optional<double> turn = TurnFromReconstruction(station)) turns.push_back(*turn);
  }
  if (turns.empty()) return;
  for (double& turn : turns) turn = turns[0] + WrapAngle(turn - turns[0]);
  const double common_rad = UpperMedian(turns);
  const std::vector<StationMatches> matches = MatchesOfStations();
  const std::set<int> by_matches = placed_stations_;
  for (const int station : stations) {
    if (by_matches.count(station) > 0) continue;
    const std::optional<double> from_reconstruction = TurnFromReconstruction(station);
    if (!from_reconstruction) continue;
    const double turn_rad = WrapAngle(*from_reconstruction - common_rad);
    int inliers = 0;
    int asked = 0;
    for (const StationMatches& pair : matches) {
      const bool is_first = pair.station == station;
      if ((!is_first && pair.other_station != station) || !pair.are_verified) continue;
      if (by_matches.count(is_first ? pair.other_station : pair.station) == 0) continue;
      // Turning the second one's camera back is turning the first one's.
      inliers +=
          SupportOfTurn(axis, pair.matches, options.max_error_px, is_first ? turn_rad : -turn_rad).inliers;
      asked += static_cast<int>(pair.matches.size());
    }
    if (asked >= options.min_inliers && inliers < options.min_share * asked) continue;
    placed_stations_.insert(station);
    TurnStation(station, turn_rad,
                {"", "its station was placed by the background's reconstruction", inliers, asked, 0});
  }
}

// What a camera of its own sees of the object does not tell how far it is turned about the axis. Where it
// sees too little of the background, it stands where its station's other photos were taken: shaking turns a
// camera more than it moves it.
void ScanRefiner::SettleLoneCameras(int enough_observations) {
  std::map<std::string, int> observations;
  for (const auto& [id, image] : aligned_->background.images) {
    int& count = observations[image.name];
    for (const ColmapPoint2D& point : image.points2D) count += point.point3D_id != kInvalidPoint3DId ? 1 : 0;
  }
  std::vector<View>& views = aligned_->scene.views;
  std::map<int, std::array<std::vector<double>, 3>> centres;  // by station
  const auto is_lone = [&](const View& view) { return observations[view.name] < enough_observations; };
  for (const View& view : views) {
    if (is_lone(view)) continue;
    const Eigen::Vector3d centre = CameraCentre(view.cam_from_world);
    for (size_t k = 0; k < 3; ++k) centres[view.station][k].push_back(centre(static_cast<Eigen::Index>(k)));
  }
  std::set<std::string> lone;
  for (const View& view : views) {
    if (is_lone(view) && centres.count(view.station) > 0) lone.insert(view.name);
  }
  if (lone.empty()) return;
  if (is_lone(*aligned_->scene.Reference())) {
    const View other = *std::find_if(views.begin(), views.end(), [&](const View& v) { return !is_lone(v); });
    MakeReference(other);
  }
  for (View& view : views) {
    if (lone.count(view.name) == 0) continue;
    const auto& of_station = centres.at(view.station);
    const Eigen::Vector3d there(UpperMedian(of_station[0]), UpperMedian(of_station[1]),
                                UpperMedian(of_station[2]));
    const TurntableAxis& axis = aligned_->scene.axis;
    TurnView(axis, AngleAboutAxis(axis, there, CameraCentre(view.cam_from_world)), &view);
  }
}

// A photo that the object's points placed has a camera of its own, which misses its station's by these
// points' errors, and nothing need tie it to the others. Where the photos of a station agree on one pose it
// has that of most, and what its camera was off about the axis its angle is.
void ScanRefiner::ShareCameras() {
  std::vector<View>& views = aligned_->scene.views;
  std::map<int, std::vector<const View*>> of_station;
  for (const View& view : views) of_station[view.station].push_back(&view);
  std::map<int, const View*> most;  // one of those that share a camera, where these are more than half
  for (const auto& [station, members] : of_station) {
    for (const View* view : members) {
      const auto sharing = std::count_if(members.begin(), members.end(), [&](const View* other) {
        return AreOnePose(other->cam_from_world, view->cam_from_world);
      });
      if (2 * static_cast<size_t>(sharing) <= members.size()) continue;
      most[station] = view;
      break;
    }
  }
  const auto is_apart = [&](const View& view) {
    const auto found = most.find(view.station);
    return found != most.end() && !AreOnePose(view.cam_from_world, found->second->cam_from_world);
  };
  if (is_apart(*aligned_->scene.Reference())) {
    const View other = *most.at(aligned_->scene.Reference()->station);
    MakeReference(other);
  }
  const TurntableAxis& axis = aligned_->scene.axis;
  for (View& view : views) {
    if (!is_apart(view)) continue;
    const Rigid3& shared = most.at(view.station)->cam_from_world;
    TurnView(axis, AngleAboutAxis(axis, CameraCentre(shared), CameraCentre(view.cam_from_world)), &view);
    view.cam_from_world = shared;
  }
}

// Without a background nothing tells what a camera of its own moved from what the object did. A station's
// camera stands still, so that it is the object that was shifted or tilted: its pose is what the camera sees,
// and its angle what of that is a turn about the axis.
void ScanRefiner::StandCamerasStill() {
  std::vector<View>& views = aligned_->scene.views;
  std::map<int, Rigid3> camera_of_station;
  for (const View& view : views) {
    if (view.name == aligned_->scene.reference) camera_of_station[view.station] = view.cam_from_world;
  }
  for (View& view : views) {
    const auto [entry, is_first] = camera_of_station.try_emplace(view.station, view.cam_from_world);
    if (is_first || view.name == aligned_->scene.reference) continue;
    view.world_from_object = entry->second.Inverse() * view.CamFromObject();
    view.cam_from_world = entry->second;
    view.angle_deg = TableAngleDeg(aligned_->scene.axis, view.world_from_object);
  }
}

// Each station may be wrong by its angle about the axis, where the object alone placed it or the background's
// reconstruction failed: matches on the background say where it stands, and whether they do.
void ScanRefiner::PlaceStations(double max_error_px) {
  std::map<int, int> images;  // by station
  int root = -1;
  for (size_t i = 0; i < view_of_image_.size(); ++i) {
    if (view_of_image_[i] < 0) continue;
    const int station = StationOf(static_cast<int>(i));
    ++images[station];
    if (features_.images[i].name == aligned_->scene.Reference()->name) root = station;
  }
  if (images.size() < 2 || images.size() > kMaxTiedStations) return;
  if (root < 0) root = images.begin()->first;
  TieOptions options;
  options.max_error_px = max_error_px;
  const std::vector<StationMatches> matches = MatchesOfStations();
  const std::vector<StationTie> ties =
      TieStations(images.rbegin()->first + 1, root, aligned_->scene.axis, matches, options);
  std::map<int, int> images_of_component;
  std::map<int, int> stations_of_component;
  for (const auto& [station, count] : images) {
    images_of_component[ties[static_cast<size_t>(station)].component] += count;
    ++stations_of_component[ties[static_cast<size_t>(station)].component];
  }
  int largest = root;
  for (const auto& [component, count] : images_of_component) {
    if (stations_of_component[component] < 2) continue;
    if (stations_of_component[largest] < 2 || count > images_of_component[largest]) largest = component;
  }
  placed_stations_.clear();
  std::set<int> by_raw_matches;
  for (const auto& [station, count] : images) {
    const StationTie& tie = ties[static_cast<size_t>(station)];
    if (tie.component != largest) continue;
    placed_stations_.insert(station);
    if (tie.by_raw_matches) by_raw_matches.insert(station);
    if (tie.turn_rad == 0) continue;
    TurnStation(
        station, tie.turn_rad,
        {"", "its station was placed by the background's matches", tie.inliers, tie.matches, tie.margin});
  }
  std::set<int> stations;
  for (const auto& [station, count] : images) stations.insert(station);
  PlaceByReconstruction(stations, options);
  // Points between stations that only raw matches tie are made from these, as far as they agree with the
  // poses.
  static_pairs_ = features_.static_pairs;
  for (const ImagePairMatches& pair : features_.raw_static_pairs) {
    if (by_raw_matches.count(StationOf(pair.image1)) + by_raw_matches.count(StationOf(pair.image2)) > 0)
      static_pairs_.push_back(pair);
  }
  has_background_ = placed_stations_.size() >= 2;
  if (!has_background_) placed_stations_.clear();
}

// The object's frame becomes the world's at another image.
void ScanRefiner::MakeReference(const View& reference) {
  aligned_->scene.reference = reference.name;
  const Rigid3 new_from_old = reference.world_from_object;
  const Rigid3 old_from_new = new_from_old.Inverse();
  const double zero_deg = reference.angle_deg;
  const Sim3 moved{1, new_from_old.rotation, new_from_old.translation};
  for (View& view : aligned_->scene.views) {
    view.world_from_object = view.world_from_object * old_from_new;
    view.angle_deg = WrapAngle((view.angle_deg - zero_deg) * kDegree) / kDegree;
  }
  TransformModel(moved, &aligned_->object);
  for (TrackPoint& point : object_points_) point.x_in_body = new_from_old * point.x_in_body;
  Sim3& from_object = aligned_->aligned_from_object;
  from_object.translation = new_from_old * from_object.translation;
  from_object.rotation = (new_from_old.rotation * from_object.rotation).normalized();
}

// Where nothing ties a station to the others the object alone says how its camera stands, but for a turn
// about the axis that is anybody's choice: its photos show the object like any others, and keep their poses.
void ScanRefiner::ReportUntiedStations() {
  std::set<int> all;
  for (size_t i = 0; i < view_of_image_.size(); ++i) {
    if (view_of_image_[i] >= 0) all.insert(StationOf(static_cast<int>(i)));
  }
  if (all.size() < 2 || all.size() > kMaxTiedStations) return;
  if (!has_background_) {
    reporter_.Debug("nothing on the background ties the " + std::to_string(all.size()) +
                    " stations to each other: their angles about the axis are unknown");
    return;
  }
  for (size_t i = 0; i < view_of_image_.size(); ++i) {
    if (view_of_image_[i] >= 0 && placed_stations_.count(StationOf(static_cast<int>(i))) == 0)
      report_.untied.push_back(features_.images[i].name);
  }
  if (report_.untied.empty()) return;
  // Angles are told against the reference: one of those that are tied.
  const std::set<std::string> names(report_.untied.begin(), report_.untied.end());
  if (names.count(aligned_->scene.Reference()->name) > 0) {
    const View tied = *std::find_if(aligned_->scene.views.begin(), aligned_->scene.views.end(),
                                    [&](const View& view) { return names.count(view.name) == 0; });
    MakeReference(tied);
  }
  reporter_.Debug(std::to_string(report_.untied.size()) + " images, the first " + report_.untied[0] +
                  ", stand to the others as the object alone says: nothing on the background ties their "
                  "station to them");
}

}  // namespace s2gs
