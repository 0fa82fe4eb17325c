#include "sfm_split/relocalise/scan_refinement.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <numeric>
#include <optional>
#include <set>
#include <utility>

#include "sfm_split/adjust/match_errors.h"
#include "sfm_split/adjust/points_apart.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/number_text.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/base/stopwatch.h"
#include "sfm_split/evidence/match_noise.h"
#include "sfm_split/joint_system/joint_problem.h"
#include "sfm_split/relocalise/scan_refiner.h"
#include "sfm_split/relocalise/unmoved_keypoints.h"
#include "sfm_split/scene/number_stations.h"

namespace s2gs {
namespace {

// A judgement: photos of one station, which shook by less than a touched tripod.
constexpr float kMaxShakePx = 8;
constexpr float kMaxUnmovedPx = 1.5F;  // as StationOptions has it
// A judgement: an image with fewer keeps every point; 160 errors for six numbers.
constexpr int kMinObservationsPerImage = 80;
constexpr double kLeastErrorPx = 1;     // below, keypoints are dropped that are only badly localised
constexpr double kFirstLossPx = 1;      // for reconstructions with other cameras than the common ones
constexpr double kMaxErrorGrowth = 4;   // of the error bound, where the matches are noisier than it expects
constexpr double kRoughErrors = 2;      // of the error bound, where poses are rough
constexpr double kNoiseRange = 6;       // of the error bound, over which matches' errors are looked at
constexpr double kMaxScaleSigma = 0.1;  // of a scale that is called observed

}  // namespace

void ScanRefiner::IndexViews() {
  view_of_image_.assign(features_.images.size(), -1);
  for (size_t v = 0; v < aligned_->scene.views.size(); ++v) {
    const auto found = image_of_name_.find(aligned_->scene.views[v].name);
    if (found != image_of_name_.end())
      view_of_image_[static_cast<size_t>(found->second)] = static_cast<int>(v);
  }
}

void ScanRefiner::SortViews() {
  std::sort(aligned_->scene.views.begin(), aligned_->scene.views.end(),
            [](const View& a, const View& b) { return a.name < b.name; });
  IndexViews();
}

const Camera& ScanRefiner::CameraOf(int image) const {
  const uint32_t id = features_.images[static_cast<size_t>(image)].camera_id;
  const Camera* const camera = aligned_->scene.FindCamera(id);
  return camera != nullptr ? *camera : features_.cameras.at(id);
}

void ScanRefiner::AddCamera(uint32_t camera_id) {
  if (aligned_->scene.FindCamera(camera_id) != nullptr) return;
  aligned_->scene.cameras.push_back(features_.cameras.at(camera_id));
}

// The view that tells where an image's camera stands: its own, else any of its station; -1: none.
std::vector<int> ScanRefiner::ViewsOfCameras() const {
  std::map<int, int> view_of_station;
  for (size_t i = 0; i < view_of_image_.size(); ++i) {
    if (view_of_image_[i] >= 0) view_of_station.emplace(StationOf(static_cast<int>(i)), view_of_image_[i]);
  }
  std::vector<int> views = view_of_image_;
  for (size_t i = 0; i < views.size(); ++i) {
    const auto found = view_of_station.find(StationOf(static_cast<int>(i)));
    if (views[i] < 0 && found != view_of_station.end()) views[i] = found->second;
  }
  return views;
}

std::vector<PosedImage> ScanRefiner::Posed(bool of_object) const {
  std::vector<PosedImage> posed(features_.images.size());
  const std::vector<int> views = of_object ? view_of_image_ : ViewsOfCameras();
  for (size_t i = 0; i < posed.size(); ++i) {
    if (views[i] < 0) continue;
    if (!of_object && placed_stations_.count(StationOf(static_cast<int>(i))) == 0) continue;
    const View& view = aligned_->scene.views[static_cast<size_t>(views[i])];
    posed[i].is_posed = true;
    posed[i].camera = &CameraOf(static_cast<int>(i));
    posed[i].cam_from_body = of_object ? view.CamFromObject() : view.cam_from_world;
  }
  return posed;
}

std::vector<TrackPoint> ScanRefiner::Triangulate(bool of_object, double max_error_px) const {
  TrackOptions options;
  options.max_error_px = max_error_px;
  options.min_triangulation_deg = options_.min_triangulation_deg;
  const std::vector<PosedImage> posed = Posed(of_object);
  std::vector<TrackPoint> points =
      TriangulateTracks(posed, keypoints_, of_object ? object_pairs_ : static_pairs_, options);
  if (!of_object) return points;
  // What turns is one thing; the background may be anywhere.
  const std::vector<bool> apart = PointsApart(posed, points);
  std::vector<TrackPoint> kept;
  for (size_t p = 0; p < points.size(); ++p)
    if (!apart[p]) kept.push_back(std::move(points[p]));
  reporter_.Debug("left out " + std::to_string(points.size() - kept.size()) + " of " +
                  std::to_string(points.size()) + " points of the object, which lie apart from it");
  return kept;
}

// Of the object's matches against the poses [px]; none of pairs without two poses.
std::vector<std::vector<double>> ScanRefiner::ErrorsOf(const std::vector<ImagePairMatches>& pairs) const {
  std::vector<const Keypoints*> keypoints;
  keypoints.reserve(keypoints_.size());
  for (const Keypoints& of_image : keypoints_) keypoints.push_back(&of_image);
  const std::vector<PosedImage> posed = Posed(true);
  return MatchErrors(posed, std::move(keypoints)).Of(pairs);
}

void ScanRefiner::MeasureNoise() {
  if (options_.noise_px > 0) {
    noise_px_ = options_.noise_px;
    return;
  }
  const NoiseFit noise =
      MeasureMatchNoise(Posed(true), keypoints_, features_.object_pairs, kNoiseRange * options_.max_error_px);
  noise_px_ = noise.sigma;
}

// The error bound for keypoints of a standard deviation; wider than the options' where the matches themselves
// are noisier than these expect, whatever an adjustment within the bound says.
double ScanRefiner::ErrorBound(double sigma_px) const {
  const double by_matches = kErrorSigmas * noise_px_;
  if (by_matches > options_.max_error_px) {
    return std::min(by_matches, kMaxErrorGrowth * options_.max_error_px);
  }
  return std::clamp(kErrorSigmas * sigma_px, std::min(kLeastErrorPx, options_.max_error_px),
                    options_.max_error_px);
}

// Adds raw matches that agree with the poses to the verified ones: verification, which knew no poses, had to
// leave out those of pairs that show little of the object.
void ScanRefiner::TakeRawMatches(double max_error_px) {
  object_pairs_ = features_.object_pairs;
  std::map<std::pair<int, int>, size_t> place;
  for (size_t p = 0; p < object_pairs_.size(); ++p) {
    place[{object_pairs_[p].image1, object_pairs_[p].image2}] = p;
  }
  const std::vector<std::vector<double>> errors = ErrorsOf(features_.raw_pairs);
  for (size_t p = 0; p < errors.size(); ++p) {
    if (errors[p].empty()) continue;
    const ImagePairMatches& raw = features_.raw_pairs[p];
    const auto i = static_cast<size_t>(raw.image1);
    const auto j = static_cast<size_t>(raw.image2);
    const auto found = place.find({raw.image1, raw.image2});
    std::vector<std::pair<uint32_t, uint32_t>> known;
    if (found != place.end()) {
      for (const FeatureMatch& match : object_pairs_[found->second].matches)
        known.emplace_back(match.point2D_idx1, match.point2D_idx2);
      std::sort(known.begin(), known.end());
    }
    const bool same_place = StationOf(raw.image1) == StationOf(raw.image2);
    FeatureMatches agreeing;
    for (size_t m = 0; m < raw.matches.size(); ++m) {
      const FeatureMatch& match = raw.matches[m];
      if (!(errors[p][m] <= max_error_px)) continue;
      if (std::binary_search(known.begin(), known.end(),
                             std::make_pair(match.point2D_idx1, match.point2D_idx2)))
        continue;
      if (IsStatic(features_.images[i], match.point2D_idx1) ||
          IsStatic(features_.images[j], match.point2D_idx2))
        continue;
      const Eigen::Vector2f& xy1 = keypoints_[i][match.point2D_idx1];
      const Eigen::Vector2f& xy2 = keypoints_[j][match.point2D_idx2];
      if (same_place && (xy1 - xy2).norm() <= kLeastMovePx) continue;
      agreeing.push_back(match);
    }
    if (agreeing.empty()) continue;
    if (found == place.end()) {
      object_pairs_.push_back({raw.image1, raw.image2, std::move(agreeing)});
    } else {
      FeatureMatches& matches = object_pairs_[found->second].matches;
      matches.insert(matches.end(), agreeing.begin(), agreeing.end());
    }
  }
}

void ScanRefiner::FindUnmoved() {
  std::map<int, std::set<uint32_t>> matched;
  const bool is_verified = !features_.static_pairs.empty();
  for (const ImagePairMatches& pair : is_verified ? features_.static_pairs : features_.raw_static_pairs) {
    for (const FeatureMatch& match : pair.matches) {
      matched[pair.image1].insert(match.point2D_idx1);
      matched[pair.image2].insert(match.point2D_idx2);
    }
  }
  std::map<int, std::vector<int>> images_of_station;
  for (size_t i = 0; i < features_.images.size(); ++i) {
    images_of_station[StationOf(static_cast<int>(i))].push_back(static_cast<int>(i));
  }
  for (const auto& [image, set] : matched) {
    const std::vector<uint32_t> chosen(set.begin(), set.end());
    for (const int other : images_of_station[StationOf(image)]) {
      if (other == image || matched.count(other) > 0) continue;
      const ScanImage& there = features_.images[static_cast<size_t>(other)];
      std::vector<bool> usable(there.keypoints.size(), false);
      for (size_t k = 0; k < usable.size() && k < there.labels.size(); ++k) {
        usable[k] = there.labels[k] == KeypointLabel::kStatic;
      }
      const std::vector<uint32_t> found =
          FindUnmovedKeypoints(keypoints_[static_cast<size_t>(image)], chosen, there.keypoints, usable,
                               kMaxShakePx, kMaxUnmovedPx);
      std::set<uint32_t> used;
      for (size_t k = 0; k < chosen.size(); ++k) {
        if (found[k] != kNoKeypoint && used.insert(found[k]).second)
          unmoved_[image][other][chosen[k]] = found[k];
      }
    }
  }
}

void ScanRefiner::AddView(int image, int station, const Rigid3& cam_from_world,
                          const Rigid3& world_from_object, double angle_rad) {
  const ScanImage& features = features_.images[static_cast<size_t>(image)];
  AddCamera(features.camera_id);
  View view;
  view.name = features.name;
  view.camera_id = features.camera_id;
  view.station = station;
  view.angle_deg = WrapAngle(angle_rad) / kDegree;
  view.cam_from_world = cam_from_world;
  view.world_from_object = world_from_object;
  view_of_image_[static_cast<size_t>(image)] = static_cast<int>(aligned_->scene.views.size());
  aligned_->scene.views.push_back(view);
}

// The points with the longest tracks, and more where an image would have few; none that are held back.
std::vector<size_t> ScanRefiner::PointsToAdjust(const std::vector<TrackPoint>& points, int max_observations,
                                                int max_points) const {
  std::vector<size_t> order(points.size());
  std::iota(order.begin(), order.end(), size_t{0});
  std::stable_sort(order.begin(), order.end(),
                   [&](size_t a, size_t b) { return points[a].track.size() > points[b].track.size(); });
  std::vector<size_t> chosen;
  std::vector<int> seen(features_.images.size(), 0);
  int64_t observations = 0;
  const auto is_held_back = [&](const TrackElement& e) {
    return report_.held_back[static_cast<size_t>(e.image)][e.keypoint];
  };
  for (const size_t p : order) {
    if (std::any_of(points[p].track.begin(), points[p].track.end(), is_held_back)) continue;
    const bool has_room = observations < max_observations && static_cast<int>(chosen.size()) < max_points;
    const bool is_wanted = std::any_of(
        points[p].track.begin(), points[p].track.end(),
        [&](const TrackElement& e) { return seen[static_cast<size_t>(e.image)] < kMinObservationsPerImage; });
    if (!has_room && !is_wanted) continue;
    chosen.push_back(p);
    observations += static_cast<int64_t>(points[p].track.size());
    for (const TrackElement& element : points[p].track) ++seen[static_cast<size_t>(element.image)];
  }
  std::sort(chosen.begin(), chosen.end());
  return chosen;
}

std::vector<TrackElement> ScanRefiner::WholeTrack(const TrackPoint& point, bool of_object) const {
  std::vector<TrackElement> track = point.track;
  if (of_object) return track;
  for (const TrackElement& element : point.track) {
    const auto others = unmoved_.find(element.image);
    if (others == unmoved_.end()) continue;
    for (const auto& [other, keypoint_of] : others->second) {
      const auto found = keypoint_of.find(element.keypoint);
      if (found != keypoint_of.end() && view_of_image_[static_cast<size_t>(other)] >= 0) {
        track.push_back({other, found->second});
      }
    }
  }
  return track;
}

ColmapModel ScanRefiner::BuildModel(const std::vector<TrackPoint>& points, const std::vector<size_t>& chosen,
                                    bool of_object) const {
  ColmapModel model;
  for (const View& view : aligned_->scene.views) {
    const auto i = static_cast<size_t>(image_of_name_.at(view.name));
    const ScanImage& features = features_.images[i];
    model.cameras[view.camera_id] = CameraOf(static_cast<int>(i));
    ColmapImage& image = model.images[features.image_id];
    image.image_id = features.image_id;
    image.name = features.name;
    image.camera_id = view.camera_id;
    image.cam_from_world = of_object ? view.CamFromObject() : view.cam_from_world;
    image.points2D.resize(features.keypoints.size());
    for (size_t k = 0; k < features.keypoints.size(); ++k) {
      image.points2D[k].xy = features.keypoints[k].cast<double>();
    }
  }
  uint64_t next_id = 1;
  for (const size_t p : chosen) {
    ColmapPoint3D point;
    point.point3D_id = next_id;
    point.xyz = points[p].x_in_body;
    point.error = points[p].mean_error_px;
    for (const TrackElement& element : WholeTrack(points[p], of_object)) {
      if (view_of_image_[static_cast<size_t>(element.image)] < 0) continue;
      const uint32_t image_id = features_.images[static_cast<size_t>(element.image)].image_id;
      ColmapPoint2D& point2D = model.images.at(image_id).points2D[element.keypoint];
      if (point2D.point3D_id != kInvalidPoint3DId) continue;
      point2D.point3D_id = next_id;
      point.track.push_back({image_id, element.keypoint});
    }
    if (point.track.size() < 2) {
      for (const ColmapTrackElement& element : point.track) {
        model.images.at(element.image_id).points2D[element.point2D_idx].point3D_id = kInvalidPoint3DId;
      }
      continue;
    }
    model.points3D[next_id++] = std::move(point);
  }
  return model;
}

// A keypoint that sees a point of one body is that body's; a rotating one none of whose matches agrees with
// the adjusted poses is unknown again.
void ScanRefiner::Relabel(double max_error_px) {
  std::vector<std::vector<KeypointLabel>> labels;
  labels.reserve(features_.images.size());
  std::vector<std::vector<bool>> agrees;
  for (const ScanImage& image : features_.images) {
    labels.push_back(image.labels);
    labels.back().resize(image.keypoints.size(), KeypointLabel::kUnknown);
    agrees.emplace_back(image.keypoints.size(), false);
  }
  // Matches on their epipolar lines.
  const std::vector<std::vector<double>> errors = ErrorsOf(object_pairs_);
  for (size_t p = 0; p < errors.size(); ++p) {
    const ImagePairMatches& pair = object_pairs_[p];
    for (size_t m = 0; m < errors[p].size(); ++m) {
      if (errors[p][m] > max_error_px) continue;
      agrees[static_cast<size_t>(pair.image1)][pair.matches[m].point2D_idx1] = true;
      agrees[static_cast<size_t>(pair.image2)][pair.matches[m].point2D_idx2] = true;
    }
  }
  for (size_t i = 0; i < labels.size(); ++i) {
    if (view_of_image_[i] < 0) continue;
    for (size_t k = 0; k < labels[i].size(); ++k) {
      if (labels[i][k] == KeypointLabel::kRotating && !agrees[i][k]) labels[i][k] = KeypointLabel::kUnknown;
    }
  }
  for (const TrackPoint& point : background_points_) {
    for (const TrackElement& element : WholeTrack(point, false)) {
      labels[static_cast<size_t>(element.image)][element.keypoint] = KeypointLabel::kStatic;
    }
  }
  for (const TrackPoint& point : object_points_) {
    for (const TrackElement& element : point.track) {
      KeypointLabel& label = labels[static_cast<size_t>(element.image)][element.keypoint];
      if (label != KeypointLabel::kStatic) label = KeypointLabel::kRotating;
    }
  }
  for (size_t i = 0; i < labels.size(); ++i) {
    for (size_t k = 0; k < labels[i].size(); ++k) {
      const KeypointLabel before =
          k < features_.images[i].labels.size() ? features_.images[i].labels[k] : KeypointLabel::kUnknown;
      report_.relabelled_keypoints += labels[i][k] != before ? 1 : 0;
    }
  }
  report_.labels = std::move(labels);
}

void ScanRefiner::WriteModels() {
  std::vector<size_t> all(object_points_.size());
  std::iota(all.begin(), all.end(), size_t{0});
  aligned_->object = BuildModel(object_points_, all, true);
  if (!has_background_) {
    aligned_->background = ColmapModel();
    return;
  }
  all.resize(background_points_.size());
  std::iota(all.begin(), all.end(), size_t{0});
  aligned_->background = BuildModel(background_points_, all, false);
}

RefineReport ScanRefiner::Run() {
  IndexViews();
  // Principal points that were found beside the middle before have their prior, and are not held there.
  for (const Camera& camera : aligned_->scene.cameras)
    photos_are_cut_ |= PrincipalPoint(camera) != PrincipalPoint(features_.cameras.at(camera.camera_id));
  if (options_.start_is_rough) {
    object_points_ = Triangulate(true, kRoughErrors * options_.max_error_px);
    aligned_->object = BuildModel(
        object_points_,
        PointsToAdjust(object_points_, options_.max_adjusted_observations, std::numeric_limits<int>::max()),
        true);
  }
  // First with the tracks of the two reconstructions, each of which fits its own cameras: this brings the two
  // to common ones. Gross errors are pulled in, not cut off.
  if (!aligned_->object.points3D.empty()) {
    JointOptions options = joint_options_;
    options.model = JointModel::kSharedStations;
    options.loss = JointLoss::kHuber;
    options.loss_scale_px = std::max(options.loss_scale_px, kFirstLossPx);
    options.max_rounds = 1;
    options.function_tolerance = 1e-5;
    options.compute_covariance = false;
    AdjustWith(options, true);
    reporter_.Debug("adjusted both reconstructions to common cameras");
  }
  FindUnmoved();

  MeasureNoise();
  const double first_error_px = std::max(options_.max_error_px, ErrorBound(0));
  double max_error_px = first_error_px;
  JointModel model =
      joint_options_.model == JointModel::kAuto ? JointModel::kSharedStations : joint_options_.model;
  int last_observations = 0;
  for (int round = 0; round < options_.max_rounds; ++round) {
    if (reporter_.StopRequested()) throw Interrupted();
    const double start = SteadySeconds();
    if (round > 0) {
      DropContradictedStations(max_error_px);
      DropDoubtful(max_error_px);
      TakeRawMatches(max_error_px);
    }
    object_points_ = Triangulate(true, max_error_px);
    for (size_t before = 0; before != aligned_->scene.views.size();) {
      before = aligned_->scene.views.size();
      if (before == features_.images.size()) break;
      // Drawn in, the bound would leave out what shook against its station.
      Relocalise(first_error_px);
      if (aligned_->scene.views.size() != before) object_points_ = Triangulate(true, max_error_px);
    }
    PlaceStations(round == 0 ? 2 * first_error_px : first_error_px);
    if (cameras_are_free_ && has_background_) SettleLoneCameras(joint_options_.min_free_observations);
    if (has_background_) background_points_ = Triangulate(false, max_error_px);
    aligned_->object = BuildModel(
        object_points_,
        PointsToAdjust(object_points_, options_.max_adjusted_observations, std::numeric_limits<int>::max()),
        true);
    if (has_background_) {
      aligned_->background = BuildModel(background_points_,
                                        PointsToAdjust(background_points_, std::numeric_limits<int>::max(),
                                                       options_.max_adjusted_background),
                                        false);
    } else {
      aligned_->background = ColmapModel();
    }
    // The poses' model is chosen once, when gross errors are out.
    const bool choose = round == 1 && joint_options_.model == JointModel::kAuto;
    report_.joint = Adjust(choose ? JointModel::kAuto : model, false);
    if (choose) {
      model = report_.joint.model;
      report_.model_tests = report_.joint.tests;
      report_.principal_point = report_.joint.principal_point;
      photos_are_cut_ = report_.principal_point.accepted;
    }
    cameras_are_free_ = model == JointModel::kFreeCameras;
    IndexViews();

    RefineRound figures;
    figures.images = static_cast<int>(aligned_->scene.views.size());
    figures.object_points = static_cast<int>(object_points_.size());
    figures.background_points = static_cast<int>(background_points_.size());
    figures.object_rms_px = report_.joint.object_rms_px;
    figures.background_rms_px = report_.joint.background_rms_px;
    figures.seconds = SteadySeconds() - start;
    report_.rounds.push_back(figures);
    reporter_.Info("round " + std::to_string(round + 1) + ": " + std::to_string(figures.images) +
                   " images, " + std::to_string(figures.object_points) + " object points, rms " +
                   std::to_string(figures.object_rms_px) + " px; " +
                   std::to_string(figures.background_points) + " background points, rms " +
                   std::to_string(figures.background_rms_px) + " px; " + std::to_string(figures.seconds) +
                   " s");
    MeasureNoise();
    max_error_px = ErrorBound(report_.joint.sigma_px);
    const int observations = report_.joint.object_observations;
    const bool is_settled = std::abs(observations - last_observations) <= 0.01 * observations;
    last_observations = observations;
    if (round >= 2 && is_settled) {
      report_.is_stable = true;
      break;
    }
  }
  DropUntiedStations();
  if (model == JointModel::kSharedStations) ShareCameras();
  report_.joint = Adjust(model, joint_options_.compute_covariance);
  report_.model = model;
  if (cameras_are_free_ && has_background_) SettleLoneCameras(1);
  if (cameras_are_free_ && !has_background_) StandCamerasStill();
  IndexViews();
  TakeRawMatches(max_error_px);
  object_points_ = Triangulate(true, max_error_px);
  if (has_background_) background_points_ = Triangulate(false, max_error_px);
  WriteModels();
  Relabel(max_error_px);

  NumberStations(&aligned_->scene);
  for (const auto& [station, placed] : turned_stations_) report_.placed_stations.push_back(placed);
  if (!has_background_) {
    aligned_->scene.scale_observable = false;
  } else if (report_.joint.scale_sigma_rel >= 0) {
    aligned_->scene.scale_observable = report_.joint.scale_sigma_rel <= kMaxScaleSigma;
  }
  for (size_t i = 0; i < features_.images.size(); ++i) {
    if (view_of_image_[i] < 0) report_.missing.push_back(features_.images[i].name);
  }
  return report_;
}

OptionCheck RefineOptions::Check() const {
  const auto fault = [](const char* field, double value, const char* bound) {
    return OptionFault{field, NumberText(value), bound};
  };
  if (!(noise_px >= 0)) return fault("noise_px", noise_px, "noise_px >= 0");
  if (max_rounds < 1) return fault("max_rounds", max_rounds, "max_rounds >= 1");
  if (!(max_error_px > 0)) return fault("max_error_px", max_error_px, "max_error_px > 0");
  if (!(min_triangulation_deg > 0 && min_triangulation_deg < 90)) {
    return fault("min_triangulation_deg", min_triangulation_deg, "0 < min_triangulation_deg < 90");
  }
  if (min_mend_inliers < 3) return fault("min_mend_inliers", min_mend_inliers, "min_mend_inliers >= 3");
  if (!(min_mend_share >= 0 && min_mend_share <= 1)) {
    return fault("min_mend_share", min_mend_share, "0 <= min_mend_share <= 1");
  }
  if (max_adjusted_observations < 1000) {
    return fault("max_adjusted_observations", max_adjusted_observations, "max_adjusted_observations >= 1000");
  }
  if (max_adjusted_background < 50) {
    return fault("max_adjusted_background", max_adjusted_background, "max_adjusted_background >= 50");
  }
  return std::nullopt;
}

RefineReport RefineScan(const ScanFeatures& features, const ColmapModel* object,
                        const JointOptions& joint_options, const RefineOptions& options, Reporter& reporter,
                        AlignedScene* aligned) {
  S2GS_INVARIANT(!options.Check() && !joint_options.Check());
  RefineReport report = ScanRefiner(features, object, joint_options, options, reporter, aligned).Run();
  if (!options.stated_angles_deg.empty() && report.known_angles.empty()) {
    report.angle_contradictions.emplace_back(
        "the stated table angles were neither checked nor used: the photos have poses of their own, as where "
        "a plate wobbles or an object is moved by hand");
  }
  return report;
}

}  // namespace s2gs
