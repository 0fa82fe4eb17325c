#include "sfm_split/photo_tracks/photo_adjuster.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <map>
#include <numeric>
#include <string>
#include <utility>

#include "sfm_split/adjust/track_triangulation.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/base/union_find.h"

namespace s2gs {
namespace {

constexpr double kCertain = 8;  // e^8 to one

// A body's observations by point.
std::vector<std::vector<size_t>> ByPoint(const JointBody& body) {
  std::vector<std::vector<size_t>> of_point(body.points.size());
  for (size_t k = 0; k < body.observations.size(); ++k)
    of_point[static_cast<size_t>(body.observations[k].point)].push_back(k);
  return of_point;
}

std::vector<PosedImage> Posed(const JointProblem& problem, bool of_object) {
  std::vector<PosedImage> posed;
  for (size_t i = 0; i < problem.images.size(); ++i) {
    const JointImage& image = problem.images[i];
    Rigid3 pose = problem.cam_from_world[static_cast<size_t>(image.pose)];
    if (of_object) pose = pose * problem.WorldFromObject(static_cast<int>(i));
    posed.push_back({true, &problem.cameras[static_cast<size_t>(image.camera)], pose});
  }
  return posed;
}

// Moves a point to where its places say, and returns their distances from it [px]; empty where it runs away.
std::vector<double> ErrorsAt(const std::vector<PosedImage>& posed, const std::vector<int>& images,
                             const std::vector<Eigen::Vector2d>& places, Eigen::Vector3d* x) {
  std::vector<PosedImage> seen_from;
  std::vector<Keypoints> keypoints;
  std::vector<TrackElement> track;
  for (size_t k = 0; k < images.size(); ++k) {
    seen_from.push_back(posed[static_cast<size_t>(images[k])]);
    keypoints.push_back({places[k].cast<float>()});
    track.push_back({static_cast<int>(k), 0});
  }
  Eigen::Vector3d moved = *x;
  if (!RefinePoint(seen_from, keypoints, track, &moved)) return {};
  *x = moved;
  std::vector<double> errors;
  for (size_t k = 0; k < images.size(); ++k)
    errors.push_back(ReprojectionErrorPx(seen_from[k], moved, places[k]));
  return errors;
}

}  // namespace

void PhotoAdjuster::FindHeldBack() {
  std::map<std::string, size_t> image_of_name;
  for (size_t i = 0; i < features_.images.size(); ++i) image_of_name[features_.images[i].name] = i;
  std::vector<size_t> feature_image;
  for (const JointImage& image : problem_.images) feature_image.push_back(image_of_name.at(image.name));
  std::vector<bool> is_held(problem_.object.points.size(), false);
  const auto is_held_back = [&](const JointObservation& o) {
    const std::vector<bool>& held = held_back_[feature_image[static_cast<size_t>(o.image)]];
    return o.point2D_idx < held.size() && held[o.point2D_idx];
  };
  for (const JointObservation& o : problem_.object.observations) {
    if (is_held_back(o)) is_held[static_cast<size_t>(o.point)] = true;
  }
  for (size_t k = 0; k < sources_.size(); ++k) {
    const auto p = static_cast<size_t>(problem_.object.observations[k].point);
    // Neighbours of the model's order, which has long tracks first, go to different halves.
    sources_[k].of = is_held[p]   ? PointSet::kHeldBack
                     : p % 2 == 0 ? PointSet::kFirstHalf
                                  : PointSet::kSecondHalf;
  }
}

void PhotoAdjuster::ChooseBackground(double keypoint_spread) {
  JointBody& body = problem_.background;
  std::vector<double> seen(body.points.size(), 0);
  for (JointObservation& o : body.observations) {
    o.spread = keypoint_spread;
    seen[static_cast<size_t>(o.point)] += o.weight;
  }
  // Those that most stations see.
  const auto most = static_cast<size_t>(options_.max_adjusted_background);
  if (body.points.size() <= most) return;
  std::vector<size_t> order(body.points.size());
  std::iota(order.begin(), order.end(), size_t{0});
  std::stable_sort(order.begin(), order.end(), [&](size_t a, size_t b) { return seen[a] > seen[b]; });
  std::vector<bool> is_chosen(body.points.size(), false);
  for (size_t k = 0; k < most; ++k) is_chosen[order[k]] = true;
  for (JointObservation& o : body.observations) o.active = is_chosen[static_cast<size_t>(o.point)];
}

void PhotoAdjuster::SetUp(const std::vector<AlignedTrack>& tracks, const JointPriors& priors,
                          double keypoint_sigma_px, double place_sigma_px, int min_places) {
  problem_ = MakeJointProblem(*aligned_);
  problem_.priors = priors;
  JointBody& body = problem_.object;
  std::map<std::string, uint32_t> id_of_name;
  for (const auto& [id, image] : aligned_->object.images) id_of_name[image.name] = id;
  std::map<std::pair<uint32_t, uint32_t>, const PatchPlace*> places;
  std::set<uint64_t> aligned_points;
  for (const AlignedTrack& track : tracks) {
    aligned_points.insert(track.point3D_id);
    for (const TrackPlace& place : track.places) {
      if (place.point2D_idx != kNoKeypoint) places[{place.image_id, place.point2D_idx}] = &place.place;
    }
  }
  const std::set<uint64_t> known(body.point_ids.begin(), body.point_ids.end());
  num_model_points_ = body.points.size();
  for (const AlignedTrack& track : tracks) {
    if (known.count(track.point3D_id) > 0) continue;
    body.points.push_back(track.patch.centre);
    body.point_ids.push_back(track.point3D_id);
  }
  const double keypoint_spread = std::max(1.0, keypoint_sigma_px / place_sigma_px);
  sources_.resize(body.observations.size());
  for (size_t k = 0; k < sources_.size(); ++k) {
    JointObservation& o = body.observations[k];
    sources_[k].keypoint = o.xy;
    const uint32_t id = id_of_name.at(problem_.images[static_cast<size_t>(o.image)].name);
    const auto found = places.find({id, o.point2D_idx});
    if (found != places.end()) {
      sources_[k].place = found->second;
      o.xy = found->second->xy;
      continue;
    }
    // A point's patch is about another place of the surface than its keypoints.
    o.active = aligned_points.count(body.point_ids[static_cast<size_t>(o.point)]) == 0;
    o.spread = keypoint_spread;
  }
  AddPlaces(tracks);
  LeaveOutKeypoints(min_places);
  FindHeldBack();
  for (size_t k = 0; k < sources_.size(); ++k)
    body.observations[k].active &= sources_[k].of != PointSet::kHeldBack;
  ChooseBackground(keypoint_spread);
}

// Those that are no keypoints'.
void PhotoAdjuster::AddPlaces(const std::vector<AlignedTrack>& tracks) {
  JointBody& body = problem_.object;
  std::map<std::string, int> index_of_name;
  for (size_t i = 0; i < problem_.images.size(); ++i)
    index_of_name[problem_.images[i].name] = static_cast<int>(i);
  std::map<uint64_t, int> index_of_point;
  for (size_t p = 0; p < body.point_ids.size(); ++p) index_of_point[body.point_ids[p]] = static_cast<int>(p);
  for (const AlignedTrack& track : tracks) {
    for (const TrackPlace& place : track.places) {
      if (place.point2D_idx != kNoKeypoint) continue;
      JointObservation o;
      o.image = index_of_name.at(aligned_->object.images.at(place.image_id).name);
      o.point = index_of_point.at(track.point3D_id);
      o.xy = place.place.xy;
      o.point2D_idx = kNoKeypoint;
      body.observations.push_back(o);
      sources_.push_back({&place.place, PointSet::kFirstHalf, o.xy});
    }
  }
}

// Keypoints share errors of their own: what is at an object's own border moves over it, and each photo of a
// series shows it alike, so that no number of them averages it out. They stay where there is little else.
void PhotoAdjuster::LeaveOutKeypoints(int min_places) {
  std::vector<JointObservation>& observations = problem_.object.observations;
  std::vector<int> num_places(problem_.images.size(), 0);
  for (size_t k = 0; k < sources_.size(); ++k)
    num_places[static_cast<size_t>(observations[k].image)] += sources_[k].place != nullptr ? 1 : 0;
  std::vector<bool> is_needed(problem_.object.points.size(), false);
  for (const JointObservation& o : observations) {
    if (num_places[static_cast<size_t>(o.image)] < min_places) is_needed[static_cast<size_t>(o.point)] = true;
  }
  for (size_t k = 0; k < sources_.size(); ++k) {
    if (sources_[k].place == nullptr)
      observations[k].active &= is_needed[static_cast<size_t>(observations[k].point)];
  }
}

JointProblem PhotoAdjuster::Without(PointSet set) const {
  JointProblem problem = problem_;
  for (size_t k = 0; k < sources_.size(); ++k) {
    if (sources_[k].of == set && sources_[k].place != nullptr) problem.object.observations[k].active = false;
  }
  return problem;
}

void PhotoAdjuster::ActivateAll(JointProblem* problem) const {
  problem->object.observations = problem_.object.observations;
  problem->background.observations = problem_.background.observations;
}

std::vector<ErrorPair> PhotoAdjuster::ErrorsOf(PointSet set, const JointProblem& before,
                                               const JointProblem& after, bool by_patches) const {
  std::vector<ErrorPair> errors;
  const std::vector<std::vector<size_t>> of_point = ByPoint(problem_.object);
  const std::vector<PosedImage> old_poses = Posed(before, true);
  const std::vector<PosedImage> new_poses = Posed(after, true);
  for (size_t p = 0; p < of_point.size(); ++p) {
    std::vector<int> images;
    std::vector<Eigen::Vector2d> places;
    for (const size_t k : of_point[p]) {
      const bool is_of_kind = by_patches ? sources_[k].place != nullptr
                                         : problem_.object.observations[k].point2D_idx != kNoKeypoint;
      if (sources_[k].of != set || !is_of_kind) continue;
      images.push_back(problem_.object.observations[k].image);
      places.push_back(by_patches ? sources_[k].place->xy : sources_[k].keypoint);
    }
    if (images.size() < 3) continue;
    ErrorPair pair;
    Eigen::Vector3d x = problem_.object.points[p];
    pair.before = ErrorsAt(old_poses, images, places, &x);
    x = problem_.object.points[p];
    pair.after = ErrorsAt(new_poses, images, places, &x);
    if (!pair.before.empty() && !pair.after.empty()) errors.push_back(std::move(pair));
  }
  return errors;
}

std::set<int> PhotoAdjuster::TiedStations(const JointProblem& after, double overdispersion) const {
  const std::vector<PosedImage> posed = Posed(after, true);
  const std::vector<std::vector<size_t>> of_point = ByPoint(problem_.object);
  std::map<std::pair<int, int>, std::vector<double>> errors;  // of a pose's places, by another's
  for (size_t p = 0; p < of_point.size(); ++p) {
    std::map<int, std::vector<size_t>> of_pose;
    for (const size_t k : of_point[p]) {
      if (sources_[k].place == nullptr) continue;
      const int image = problem_.object.observations[k].image;
      of_pose[problem_.images[static_cast<size_t>(image)].pose].push_back(k);
    }
    for (const auto& [from, seen] : of_pose) {
      if (of_pose.size() < 2 || seen.size() < 2) continue;
      std::vector<int> images;
      std::vector<Eigen::Vector2d> places;
      for (const size_t k : seen) {
        images.push_back(problem_.object.observations[k].image);
        places.push_back(sources_[k].place->xy);
      }
      Eigen::Vector3d x = after.object.points[p];
      if (ErrorsAt(posed, images, places, &x).empty()) continue;
      for (const auto& [to, others] : of_pose) {
        if (to == from) continue;
        std::vector<double> distances;
        for (const size_t k : others) {
          const int image = problem_.object.observations[k].image;
          distances.push_back(
              ReprojectionErrorPx(posed[static_cast<size_t>(image)], x, sources_[k].place->xy));
        }
        errors[{from, to}].push_back(UpperMedian(std::move(distances)));
      }
    }
  }
  UnionFind tied(after.cam_from_world.size());
  for (const auto& [pair, distances] : errors) {
    const double ratio = LogRatioOfLinks(distances, options_.places.patch.max_move_px);
    if (ratio > kCertain * overdispersion)
      tied.Join(static_cast<uint32_t>(pair.first), static_cast<uint32_t>(pair.second));
  }
  std::map<std::string, int> station_of_name;
  for (const View& view : aligned_->scene.views) station_of_name[view.name] = view.station;
  const auto root_of = [&](const JointImage& image) { return tied.Root(static_cast<uint32_t>(image.pose)); };
  const uint32_t root = root_of(after.images[static_cast<size_t>(after.reference)]);
  std::set<int> stations;
  for (const JointImage& image : after.images) {
    if (root_of(image) == root) stations.insert(station_of_name.at(image.name));
  }
  return stations;
}

void PhotoAdjuster::Take(JointProblem* after) {
  for (const bool of_object : {true, false}) {
    JointBody& body = of_object ? after->object : after->background;
    const std::vector<PosedImage> posed = Posed(*after, of_object);
    const std::vector<std::vector<size_t>> of_point = ByPoint(body);
    for (size_t p = 0; p < of_point.size(); ++p) {
      std::vector<int> images;
      std::vector<Eigen::Vector2d> places;
      bool has_places = false;
      for (const size_t k : of_point[p]) has_places |= of_object && sources_[k].place != nullptr;
      for (const size_t k : of_point[p]) {
        if (has_places && sources_[k].place == nullptr) continue;
        images.push_back(body.observations[k].image);
        places.push_back(body.observations[k].xy);
      }
      ErrorsAt(posed, images, places, &body.points[p]);
      for (const size_t k : of_point[p]) {
        JointObservation& o = body.observations[k];
        o.active = ReprojectionErrorPx(posed[static_cast<size_t>(o.image)], body.points[p], o.xy) <=
                   options_.max_error_px;
      }
    }
  }
  std::map<std::string, ColmapImage*> image_of_name;
  for (auto& [id, image] : aligned_->object.images) image_of_name[image.name] = &image;
  for (size_t k = 0; k < sources_.size(); ++k) {
    const JointObservation& o = after->object.observations[k];
    if (sources_[k].place == nullptr || o.point2D_idx == kNoKeypoint) continue;
    image_of_name.at(after->images[static_cast<size_t>(o.image)].name)->points2D[o.point2D_idx].xy = o.xy;
  }
  // Models' tracks are of keypoints.
  std::vector<JointObservation>& observations = after->object.observations;
  observations.erase(std::remove_if(observations.begin(), observations.end(),
                                    [](const JointObservation& o) { return o.point2D_idx == kNoKeypoint; }),
                     observations.end());
  after->object.points.resize(num_model_points_);
  after->object.point_ids.resize(num_model_points_);
  ApplyJointProblem(*after, aligned_);
}

}  // namespace s2gs
