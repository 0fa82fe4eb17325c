#include "sfm_split/photo_tracks/photo_adjustment.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numeric>
#include <set>
#include <utility>
#include <vector>

#include "sfm_split/adjust/joint_problem.h"
#include "sfm_split/adjust/joint_system.h"
#include "sfm_split/adjust/track_triangulation.h"
#include "sfm_split/base/infinity.h"
#include "sfm_split/base/number_text.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/base/stopwatch.h"
#include "sfm_split/base/union_find.h"

namespace s2gs {
namespace {

constexpr double kSigmaOfMedian = 0.849;  // of a coordinate, over the median length of errors in the plane
constexpr double kHalfTolerance = 1e-6;   // of adjustments that only tell whether patches gain
// Of places over an arc: beyond, more of their errors is what bends or is lit otherwise than is noise.
constexpr double kMostOverdispersion = 2;
constexpr double kCertain = 8;  // e^8 to one
// Of links between two stations, at least: the rest may be patches of something else.
constexpr double kRightShare = 0.5;
constexpr double kMaxFocalChange = 1.1;  // more than patches can mend: something else is wrong

// The object's points: those that the scene's adjustment did not see, and the others in two halves, each of
// which tells whether poses by the other's patches are better.
enum class PointSet { kHeldBack, kFirstHalf, kSecondHalf };

// Distances of a point's places from it [px], by two sets of poses.
struct ErrorPair {
  std::vector<double> before;
  std::vector<double> after;
};

// What is known of an observation of the problem beside what the problem says.
struct Source {
  const PatchPlace* place = nullptr;
  PointSet of = PointSet::kFirstHalf;  // its point
  Eigen::Vector2d keypoint = Eigen::Vector2d::Zero();
};

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

class PhotoAdjuster {
 public:
  PhotoAdjuster(const ScanFeatures& features, const HeldBackKeypoints& held_back,
                const PhotoAdjustmentOptions& options, AlignedScene* aligned)
      : features_(features), held_back_(held_back), options_(options), aligned_(aligned) {}

  // \param min_places  photos with fewer keep the keypoints of points without patches.
  void SetUp(const std::vector<AlignedTrack>& tracks, const JointPriors& priors, double keypoint_sigma_px,
             double place_sigma_px, int min_places);
  JointProblem Without(PointSet set) const;
  void ActivateAll(JointProblem* problem) const;
  std::vector<ErrorPair> ErrorsOf(PointSet set, const JointProblem& after, bool by_patches) const;
  std::set<int> TiedStations(const JointProblem& after, const HeldBackChange& patches) const;
  void Take(JointProblem* after);
  const JointProblem& problem() const { return problem_; }

 private:
  void AddPlaces(const std::vector<AlignedTrack>& tracks);
  void LeaveOutKeypoints(int min_places);
  void FindHeldBack();
  void ChooseBackground(double keypoint_spread);

  const ScanFeatures& features_;
  const HeldBackKeypoints& held_back_;
  const PhotoAdjustmentOptions& options_;
  AlignedScene* aligned_;
  JointProblem problem_;         // as the scene stands, with the observations that are to be adjusted
  std::vector<Source> sources_;  // of the object's observations
};

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

// Those in photos beside the tracks.
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

// Without the patches of a set; keypoints of its points that have no patches stay.
JointProblem PhotoAdjuster::Without(PointSet set) const {
  JointProblem problem = problem_;
  for (size_t k = 0; k < sources_.size(); ++k) {
    if (sources_[k].of == set && sources_[k].place != nullptr) problem.object.observations[k].active = false;
  }
  return problem;
}

// Observations as they are before any adjustment takes some out.
void PhotoAdjuster::ActivateAll(JointProblem* problem) const {
  problem->object.observations = problem_.object.observations;
  problem->background.observations = problem_.background.observations;
}

// Both sets of poses see the same places of the same points, which lie where these poses put them best.
std::vector<ErrorPair> PhotoAdjuster::ErrorsOf(PointSet set, const JointProblem& after,
                                               bool by_patches) const {
  std::vector<ErrorPair> errors;
  const std::vector<std::vector<size_t>> of_point = ByPoint(problem_.object);
  const std::vector<PosedImage> old_poses = Posed(problem_, true);
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

HeldBackChange ChangeOf(const std::vector<ErrorPair>& errors) {
  HeldBackChange change;
  change.points = static_cast<int>(errors.size());
  if (errors.size() < 2) return change;
  std::vector<double> before;
  std::vector<double> after;
  for (const ErrorPair& pair : errors) {
    before.insert(before.end(), pair.before.begin(), pair.before.end());
    after.insert(after.end(), pair.after.begin(), pair.after.end());
  }
  change.before_px = UpperMedian(std::move(before));
  change.after_px = UpperMedian(std::move(after));
  // The adjustment's own loss, of both alike.
  const double scale = LossScalePx(kSigmaOfMedian * std::min(change.before_px, change.after_px));
  const auto loss = [&](double error) { return std::log1p(error * error / (scale * scale)); };
  std::vector<double> gains;
  for (const ErrorPair& pair : errors) {
    double gain = 0;
    for (size_t k = 0; k < pair.before.size(); ++k) gain += loss(pair.before[k]) - loss(pair.after[k]);
    gains.push_back(gain);
  }
  const auto count = static_cast<double>(gains.size());
  change.gain = std::accumulate(gains.begin(), gains.end(), 0.0) / count;
  double squares = 0;
  for (const double gain : gains) squares += (gain - change.gain) * (gain - change.gain);
  change.gain_sigma = std::sqrt(squares / (count - 1) / count);
  return change;
}

std::set<int> PhotoAdjuster::TiedStations(const JointProblem& after, const HeldBackChange& patches) const {
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
    if (ratio > kCertain * patches.overdispersion)
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

// All points by the new poses, whether they were adjusted or not.
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
  ApplyJointProblem(*after, aligned_);
}

std::string PxText(double px) { return NumberText(std::round(1e4 * px) / 1e4) + " px"; }

// Keypoints share errors of their own, a bias of some hundredths of a pixel, which poses that followed them
// explain and better ones do not.
bool Contradict(const HeldBackChange& keypoints, const HeldBackChange& patches) {
  return std::hypot(keypoints.before_px, patches.after_px) < keypoints.after_px;
}

bool CamerasHold(const JointProblem& before, const JointProblem& after) {
  for (size_t c = 0; c < before.cameras.size(); ++c) {
    const double ratio = FocalLengths(after.cameras[c]).x() / FocalLengths(before.cameras[c]).x();
    if (!(ratio < kMaxFocalChange && ratio > 1 / kMaxFocalChange)) return false;
  }
  return true;
}

// The mean change of the logarithms of standard deviations that both adjustments state: of focal lengths,
// axis and table angles. Infinite where none can be compared.
double LogSigmaChange(const JointReport& before, const JointReport& after) {
  double sum = 0;
  int count = 0;
  const auto compare = [&](double a, double b) {
    if (!(a > 0 && b > 0 && std::isfinite(a) && std::isfinite(b))) return;
    sum += std::log(b / a);
    ++count;
  };
  const auto middle = [](const std::vector<double>& sigmas) {
    return sigmas.empty() ? -1.0 : UpperMedian(std::vector<double>(sigmas));
  };
  compare(middle(before.focal_sigma_px), middle(after.focal_sigma_px));
  compare(before.axis_direction_sigma_deg, after.axis_direction_sigma_deg);
  compare(middle(before.angle_sigma_deg), middle(after.angle_sigma_deg));
  return count > 0 ? sum / count : kInfinity;
}

// What all ways of looking for places have in common.
struct AdjustmentInput {
  const ReadGreyPhoto& read;
  const ScanFeatures& features;
  const HeldBackKeypoints& held_back;
  const JointPriors& priors;
  const JointOptions& joint_options;
  JointModel model;
  const PhotoAdjustmentOptions& options;
};

// By places that are looked for as the options say.
PhotoAdjustment AdjustOnce(const AdjustmentInput& input, const TrackPlacesOptions& places, int min_places,
                           Reporter& reporter, AlignedScene* aligned, JointReport* joint) {
  PhotoAdjustment result;
  result.looked_in = places.min_facing < 1 ? PhotosLookedIn::kFacing : PhotosLookedIn::kTracks;
  const auto finish = [&](const std::string& finding) {
    result.finding = finding;
    return result;
  };
  const std::vector<AlignedTrack> tracks = AlignTracks(aligned->object, input.read, places, reporter);
  std::vector<double> sigmas;
  for (const AlignedTrack& track : tracks) {
    for (const TrackPlace& place : track.places) {
      sigmas.push_back(place.place.sigma_px);
      result.places_beside += place.point2D_idx == kNoKeypoint ? 1 : 0;
    }
  }
  result.tracks = static_cast<int>(tracks.size());
  result.places = static_cast<int>(sigmas.size());
  if (sigmas.empty()) return finish("patches of the photos agree nowhere");
  result.sigma_px = UpperMedian(std::move(sigmas));

  PhotoAdjuster adjuster(input.features, input.held_back, input.options, aligned);
  adjuster.SetUp(tracks, input.priors, joint->sigma_px, result.sigma_px, min_places);
  JointOptions by_patches = input.joint_options;
  by_patches.model = input.model;
  by_patches.loss_scale_px = 0;
  std::vector<ErrorPair> errors;
  JointOptions of_half = by_patches;
  of_half.compute_covariance = false;
  of_half.function_tolerance = std::max(kHalfTolerance, of_half.function_tolerance);
  of_half.max_rounds = 1;
  JointProblem problem;
  for (const PointSet half : {PointSet::kFirstHalf, PointSet::kSecondHalf}) {
    problem = adjuster.Without(half);
    AdjustJointly(of_half, reporter, &problem);
    const std::vector<ErrorPair> of_other = adjuster.ErrorsOf(half, problem, true);
    errors.insert(errors.end(), of_other.begin(), of_other.end());
  }
  result.patches = ChangeOf(errors);
  result.patches.overdispersion = std::max(1.0, kSigmaOfMedian * result.patches.after_px / result.sigma_px);
  const std::string of_photos = result.looked_in == PhotosLookedIn::kFacing ? "in all photos that they face"
                                                                            : "in photos of their tracks";
  const std::string change = PxText(result.patches.before_px) + " to " + PxText(result.patches.after_px);
  const std::string no_better = "patches do not tell better poses for each other: " + change;
  if (result.patches.HasRisen()) return finish(no_better);
  const bool is_noise = result.patches.overdispersion <= kMostOverdispersion;
  if (result.places_beside > 0 && !is_noise)
    return finish("patches are not the same from all around: " + PxText(result.patches.after_px) + ", not " +
                  PxText(result.sigma_px / kSigmaOfMedian));
  adjuster.ActivateAll(&problem);  // from a half's poses on
  JointReport report = AdjustJointly(by_patches, reporter, &problem);
  result.log_sigma_change = LogSigmaChange(*joint, report);
  // Standard deviations know of noise alone.
  const bool is_surer = is_noise && result.log_sigma_change < 0;
  if (!result.patches.HasFallen() && !is_surer) return finish(no_better);
  result.keypoints = ChangeOf(adjuster.ErrorsOf(PointSet::kHeldBack, problem, false));
  if (!CamerasHold(adjuster.problem(), problem)) return finish("patches ask for another focal length");
  if (Contradict(result.keypoints, result.patches))
    return finish("keypoints that were held back contradict the patches");
  result.tied_stations = adjuster.TiedStations(problem, result.patches);
  adjuster.Take(&problem);
  *joint = std::move(report);
  result.is_taken = true;
  if (result.patches.HasFallen()) {
    result.reason = PhotoReason::kHeldBackPatches;
    return finish("points looked for " + of_photos + ", errors of patches that were held back went from " +
                  change);
  }
  result.reason = PhotoReason::kStandardDeviations;
  return finish("points looked for " + of_photos + ", errors of patches that were held back are no larger (" +
                change + "), and standard deviations " +
                std::to_string(std::lround(100 * (1 - std::exp(result.log_sigma_change)))) + " % smaller");
}

}  // namespace

double LogRatioOfLinks(const std::vector<double>& errors, double reach_px) {
  if (errors.empty()) return 0;
  const double sigma = UpperMedian(errors) * kSigmaOfMedian;
  const double over_chance = reach_px * reach_px / (2 * sigma * sigma);
  double sum = 0;
  for (const double error : errors) {
    sum += std::log(1 - kRightShare +
                    kRightShare * over_chance * std::exp(-error * error / (2 * sigma * sigma)));
  }
  return sum;
}

OptionCheck PhotoAdjustmentOptions::Check() const {
  const auto fault = [](const char* field, double value, const char* bound) {
    return OptionFault{field, NumberText(value), bound};
  };
  if (!(max_error_px > 0)) return fault("max_error_px", max_error_px, "max_error_px > 0");
  if (max_adjusted_background < 50) {
    return fault("max_adjusted_background", max_adjusted_background, "max_adjusted_background >= 50");
  }
  return places.Check();
}

PhotoAdjustment AdjustByPhotos(const ReadGreyPhoto& read, const ScanFeatures& features,
                               const HeldBackKeypoints& held_back, const JointPriors& priors,
                               const JointOptions& joint_options, JointModel model,
                               const PhotoAdjustmentOptions& options, Reporter& reporter,
                               AlignedScene* aligned, JointReport* joint) {
  S2GS_INVARIANT(!options.Check() && !joint_options.Check());
  const double start = SteadySeconds();
  const AdjustmentInput input{read, features, held_back, priors, joint_options, model, options};
  PhotoAdjustment result =
      AdjustOnce(input, options.places, joint_options.min_free_observations, reporter, aligned, joint);
  if (!result.is_taken && result.places_beside > 0) {
    // What bends or is lit otherwise as it turns is one thing from neighbouring angles only.
    const std::string facing_finding = result.finding;
    TrackPlacesOptions of_tracks = options.places;
    of_tracks.min_facing = 1;
    result = AdjustOnce(input, of_tracks, std::numeric_limits<int>::max(), reporter, aligned, joint);
    result.facing_finding = facing_finding;
  }
  result.seconds = SteadySeconds() - start;
  return result;
}

}  // namespace s2gs
