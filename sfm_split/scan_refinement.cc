#include "sfm_split/scan_refinement.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <limits>
#include <map>
#include <numeric>
#include <optional>
#include <set>

#include "sfm_split/joint_problem.h"
#include "sfm_split/match_noise.h"
#include "sfm_split/rotation.h"
#include "sfm_split/station_ties.h"
#include "sfm_split/table_angle.h"
#include "sfm_split/track_triangulation.h"
#include "sfm_split/unmoved_keypoints.h"

namespace s2gs {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kDegree = 3.14159265358979323846 / 180;
constexpr int kMinEqualSteps = 4;                  // images that tell a station's step
constexpr double kEqualStepBound = 0.7 * kDegree;  // of an angle from the line of equal steps
constexpr double kDoubtfulShare = 0.5;             // of the median share of agreeing matches
constexpr int kMaxDrops = 2;                       // of one image
constexpr double kMaxFocalChange = 1.4;            // of one adjustment; more: it is not observable
constexpr float kMaxShakePx = 8;
constexpr float kMaxUnmovedPx = 1.5F;
constexpr float kLeastMovePx = 3;  // of a raw match in one station: less may be the background's
constexpr int kMinObservationsPerImage = 80;
constexpr double kLeastErrorPx = 1;    // below, keypoints are dropped that are only badly localised
constexpr double kErrorSigmas = 5;     // of a coordinate
constexpr double kLossSigmas = 2;      // of a coordinate, where the loss turns from squared
constexpr double kMaxErrorGrowth = 4;  // of the error bound, where the matches are noisier than it expects
constexpr double kNoiseRange = 6;      // of the error bound, over which matches' errors are looked at
constexpr int kMaxBasesOfStation = 4;  // images that are tried as a lost station's first
constexpr double kClearMargin =
    1.5;  // an angle is doubtful when another has more than 1 / this of its support
// Support so far beyond that of any other angle stands whatever the share of outliers.
constexpr double kOverwhelmingMargin = 4;
constexpr int kOverwhelmingInliers = 4;  // times those that must agree anyway
constexpr double kStepsSupport = 0.85;   // of the best angle's, that the one by equal steps must have
constexpr size_t kMaxTiedStations = 24;  // more are a camera held by hand
constexpr double kMaxScaleSigma = 0.1;   // of a scale that is called observed

class Refiner {
 public:
  Refiner(const ScanFeatures& features, const ColmapModel* object, const JointOptions& joint_options,
          const RefineOptions& options, Reporter& reporter, AlignedScene* aligned)
      : features_(features),
        object_(object),
        joint_options_(joint_options),
        options_(options),
        reporter_(reporter),
        aligned_(aligned),
        object_pairs_(features.object_pairs) {
    keypoints_.reserve(features.images.size());
    for (size_t i = 0; i < features.images.size(); ++i) {
      keypoints_.push_back(features.images[i].keypoints);
      image_of_name_[features.images[i].name] = static_cast<int>(i);
    }
    has_background_ = !aligned->background.images.empty();
    for (const auto& [id, image] : aligned->background.images) {
      const auto found = image_of_name_.find(image.name);
      if (found != image_of_name_.end()) placed_stations_.insert(StationOf(found->second));
    }
  }

  RefineReport Run();

 private:
  int StationOf(int image) const { return features_.images[static_cast<size_t>(image)].station; }
  void IndexViews();
  void SortViews();
  std::vector<int> ViewsOfCameras() const;
  std::vector<PosedImage> Posed(bool of_object) const;
  std::vector<TrackPoint> Triangulate(bool of_object, double max_error_px) const;
  void FindUnmoved();
  void MeasureNoise();
  void TakeRawMatches(double max_error_px);
  double ErrorBound(double sigma_px) const;
  void Mend(double max_error_px);
  void PlaceStations(double max_error_px);
  std::vector<StationMatches> MatchesOfStations() const;
  void TurnStation(int station, const StationTie& tie);
  void DropUntiedStations();
  void MakeReference(const View& reference);
  int NewStation() const;
  bool MendStationByObject(const std::vector<int>& images, double max_error_px);
  void MendStation(const std::vector<int>& images, double max_error_px);
  bool MendImage(int image, const Rigid3& cam_from_world, int station, double max_error_px);
  std::vector<MatchInPosedImage> MatchesWithPosed(int image) const;
  std::vector<MatchAcrossTurn> RawMatchesWithPosed(int image, const Rigid3& cam_from_world) const;
  bool MendByRawMatches(int image, const Rigid3& cam_from_world, int station, double max_error_px);
  bool IsStatic(int image, uint32_t keypoint) const;
  std::optional<double> AngleByEqualSteps(int image) const;
  bool MendBySteps(int image, const Rigid3& cam_from_world, int station, double max_error_px);
  void DropDoubtful(double max_error_px);
  void AddView(int image, int station, const Rigid3& cam_from_world, const Rigid3& world_from_object,
               double angle_rad);
  void AddCamera(uint32_t camera_id);
  const Camera& CameraOf(int image) const;
  std::vector<size_t> PointsToAdjust(const std::vector<TrackPoint>& points, int max_observations,
                                     int max_points) const;
  ColmapModel BuildModel(const std::vector<TrackPoint>& points, const std::vector<size_t>& chosen,
                         bool of_object) const;
  std::vector<TrackElement> WholeTrack(const TrackPoint& point, bool of_object) const;
  JointReport Adjust(JointModel model, bool covariance);
  JointReport AdjustWith(JointOptions options);
  void Relabel(double max_error_px);
  void WriteModels();

  const ScanFeatures& features_;
  const ColmapModel* object_;
  const JointOptions& joint_options_;
  const RefineOptions& options_;
  Reporter& reporter_;
  AlignedScene* aligned_;
  std::vector<Keypoints> keypoints_;
  std::vector<ImagePairMatches> object_pairs_;  // verified, and raw ones that agree with the poses
  std::map<std::string, int> image_of_name_;
  std::vector<int> view_of_image_;
  std::set<int> placed_stations_;  // in the features' numbers: those that the background ties to each other
  std::map<int, MendedImage> turned_stations_;
  bool has_background_ = false;
  bool holds_cameras_ = false;
  double noise_px_ = 0;  // of the object's matches against the poses as they stand
  std::map<std::string, int> drops_;
  std::set<int> by_steps_;  // images whose angle was taken from their station's equal steps
  // Of images in static pairs: keypoints at the same pixel, [image][other image of the station][keypoint].
  std::map<int, std::map<int, std::map<uint32_t, uint32_t>>> unmoved_;
  std::vector<TrackPoint> object_points_;
  std::vector<TrackPoint> background_points_;
  RefineReport report_;
};

void Refiner::IndexViews() {
  view_of_image_.assign(features_.images.size(), -1);
  for (size_t v = 0; v < aligned_->scene.views.size(); ++v) {
    const auto found = image_of_name_.find(aligned_->scene.views[v].name);
    if (found != image_of_name_.end())
      view_of_image_[static_cast<size_t>(found->second)] = static_cast<int>(v);
  }
}

void Refiner::SortViews() {
  std::sort(aligned_->scene.views.begin(), aligned_->scene.views.end(),
            [](const View& a, const View& b) { return a.name < b.name; });
  IndexViews();
}

const Camera& Refiner::CameraOf(int image) const {
  const uint32_t id = features_.images[static_cast<size_t>(image)].camera_id;
  for (const Camera& camera : aligned_->scene.cameras) {
    if (camera.camera_id == id) return camera;
  }
  return features_.cameras.at(id);
}

void Refiner::AddCamera(uint32_t camera_id) {
  for (const Camera& camera : aligned_->scene.cameras) {
    if (camera.camera_id == camera_id) return;
  }
  aligned_->scene.cameras.push_back(features_.cameras.at(camera_id));
}

// The view that tells where an image's camera stands: its own, else any of its station; -1: none.
std::vector<int> Refiner::ViewsOfCameras() const {
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

std::vector<PosedImage> Refiner::Posed(bool of_object) const {
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

std::vector<TrackPoint> Refiner::Triangulate(bool of_object, double max_error_px) const {
  TrackOptions options;
  options.max_error_px = max_error_px;
  options.min_triangulation_deg = options_.min_triangulation_deg;
  return TriangulateTracks(Posed(of_object), keypoints_, of_object ? object_pairs_ : features_.static_pairs,
                           options);
}

void Refiner::MeasureNoise() {
  const NoiseFit noise =
      MeasureMatchNoise(Posed(true), keypoints_, features_.object_pairs, kNoiseRange * options_.max_error_px);
  noise_px_ = noise.sigma;
}

// The error bound for keypoints of a standard deviation; wider than the options' where the matches themselves
// are noisier than these expect, whatever an adjustment within the bound says.
double Refiner::ErrorBound(double sigma_px) const {
  const double by_matches = kErrorSigmas * noise_px_;
  if (by_matches > options_.max_error_px) {
    return std::min(by_matches, kMaxErrorGrowth * options_.max_error_px);
  }
  return std::clamp(kErrorSigmas * sigma_px, std::min(kLeastErrorPx, options_.max_error_px),
                    options_.max_error_px);
}

bool Refiner::IsStatic(int image, uint32_t keypoint) const {
  const std::vector<KeypointLabel>& labels = features_.images[static_cast<size_t>(image)].labels;
  return keypoint < labels.size() && labels[keypoint] == KeypointLabel::kStatic;
}

// Adds raw matches that agree with the poses to the verified ones: verification, which knew no poses, had to
// leave out those of pairs that show little of the object.
void Refiner::TakeRawMatches(double max_error_px) {
  object_pairs_ = features_.object_pairs;
  std::map<std::pair<int, int>, size_t> place;
  for (size_t p = 0; p < object_pairs_.size(); ++p) {
    place[{object_pairs_[p].image1, object_pairs_[p].image2}] = p;
  }
  const std::vector<PosedImage> posed = Posed(true);
  for (const ImagePairMatches& raw : features_.raw_pairs) {
    const auto i = static_cast<size_t>(raw.image1);
    const auto j = static_cast<size_t>(raw.image2);
    if (!posed[i].is_posed || !posed[j].is_posed) continue;
    const auto found = place.find({raw.image1, raw.image2});
    std::set<std::pair<uint32_t, uint32_t>> known;
    if (found != place.end()) {
      for (const FeatureMatch& match : object_pairs_[found->second].matches)
        known.emplace(match.point2D_idx1, match.point2D_idx2);
    }
    const bool same_place = StationOf(raw.image1) == StationOf(raw.image2);
    FeatureMatches agreeing;
    for (const FeatureMatch& match : raw.matches) {
      if (known.count({match.point2D_idx1, match.point2D_idx2}) > 0) continue;
      if (IsStatic(raw.image1, match.point2D_idx1) || IsStatic(raw.image2, match.point2D_idx2)) continue;
      const Eigen::Vector2f& xy1 = keypoints_[i][match.point2D_idx1];
      const Eigen::Vector2f& xy2 = keypoints_[j][match.point2D_idx2];
      if (same_place && (xy1 - xy2).norm() <= kLeastMovePx) continue;
      if (MatchErrorPx(posed[i], posed[j], xy1.cast<double>(), xy2.cast<double>()) <= max_error_px)
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

void Refiner::FindUnmoved() {
  std::map<int, std::set<uint32_t>> matched;
  for (const ImagePairMatches& pair : features_.static_pairs) {
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

void Refiner::AddView(int image, int station, const Rigid3& cam_from_world, const Rigid3& world_from_object,
                      double angle_rad) {
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

// The image's keypoints that match a keypoint of a known point; of several points those with most matches.
std::vector<PointInImage> PointsSeenBy(int image, const ScanFeatures& features,
                                       const std::vector<ImagePairMatches>& pairs,
                                       const std::vector<TrackPoint>& points) {
  std::map<std::pair<int, uint32_t>, int> point_of_keypoint;
  std::set<int> partners;
  for (const ImagePairMatches& pair : pairs) {
    if (pair.image1 == image) partners.insert(pair.image2);
    if (pair.image2 == image) partners.insert(pair.image1);
  }
  for (size_t p = 0; p < points.size(); ++p) {
    for (const TrackElement& element : points[p].track) {
      if (partners.count(element.image) > 0) {
        point_of_keypoint[{element.image, element.keypoint}] = static_cast<int>(p);
      }
    }
  }
  std::map<uint32_t, std::map<int, int>> votes;  // for points, by keypoint
  for (const ImagePairMatches& pair : pairs) {
    if (pair.image1 != image && pair.image2 != image) continue;
    const bool is_first = pair.image1 == image;
    for (const FeatureMatch& match : pair.matches) {
      const auto found = point_of_keypoint.find(
          {is_first ? pair.image2 : pair.image1, is_first ? match.point2D_idx2 : match.point2D_idx1});
      if (found != point_of_keypoint.end()) {
        ++votes[is_first ? match.point2D_idx1 : match.point2D_idx2][found->second];
      }
    }
  }
  std::vector<PointInImage> result;
  result.reserve(votes.size());
  const Keypoints& keypoints = features.images[static_cast<size_t>(image)].keypoints;
  for (const auto& [keypoint, votes_of_point] : votes) {
    int most = 0;
    for (const auto& [point, count] : votes_of_point) most = std::max(most, count);
    for (const auto& [point, count] : votes_of_point) {
      if (count < most) continue;
      result.push_back({points[static_cast<size_t>(point)].x_in_body, keypoints[keypoint].cast<double>()});
    }
  }
  return result;
}

std::vector<MatchInPosedImage> Refiner::MatchesWithPosed(int image) const {
  const std::vector<PosedImage> posed = Posed(true);
  std::vector<MatchInPosedImage> result;
  for (const ImagePairMatches& pair : features_.object_pairs) {
    if (pair.image1 != image && pair.image2 != image) continue;
    const bool is_first = pair.image1 == image;
    const auto other = static_cast<size_t>(is_first ? pair.image2 : pair.image1);
    if (!posed[other].is_posed) continue;
    for (const FeatureMatch& match : pair.matches) {
      const uint32_t mine = is_first ? match.point2D_idx1 : match.point2D_idx2;
      const uint32_t theirs = is_first ? match.point2D_idx2 : match.point2D_idx1;
      result.push_back({keypoints_[static_cast<size_t>(image)][mine].cast<double>(), posed[other].camera,
                        posed[other].cam_from_body, keypoints_[other][theirs].cast<double>()});
    }
  }
  return result;
}

// The same of raw matches that may be the object's.
std::vector<MatchAcrossTurn> Refiner::RawMatchesWithPosed(int image, const Rigid3& cam_from_world) const {
  const std::vector<PosedImage> posed = Posed(true);
  std::vector<MatchAcrossTurn> result;
  for (const ImagePairMatches& pair : features_.raw_pairs) {
    if (pair.image1 != image && pair.image2 != image) continue;
    const bool is_first = pair.image1 == image;
    const int other = is_first ? pair.image2 : pair.image1;
    const PosedImage& there = posed[static_cast<size_t>(other)];
    if (!there.is_posed) continue;
    const bool same_place = StationOf(image) == StationOf(other);
    for (const FeatureMatch& match : pair.matches) {
      const uint32_t mine = is_first ? match.point2D_idx1 : match.point2D_idx2;
      const uint32_t theirs = is_first ? match.point2D_idx2 : match.point2D_idx1;
      if (IsStatic(image, mine) || IsStatic(other, theirs)) continue;
      const Eigen::Vector2f& xy = keypoints_[static_cast<size_t>(image)][mine];
      const Eigen::Vector2f& other_xy = keypoints_[static_cast<size_t>(other)][theirs];
      if (same_place && (xy - other_xy).norm() <= kLeastMovePx) continue;
      result.push_back({&CameraOf(image), cam_from_world, xy.cast<double>(), there.camera,
                        there.cam_from_body, other_xy.cast<double>()});
    }
  }
  return result;
}

bool Refiner::MendImage(int image, const Rigid3& cam_from_world, int station, double max_error_px) {
  const TurntableAxis& axis = aligned_->scene.axis;
  const auto accept = [&](const TableAngleFit& fit, size_t candidates, double min_share, const char* how) {
    const bool is_overwhelming =
        fit.margin >= kOverwhelmingMargin && fit.inliers >= kOverwhelmingInliers * options_.min_mend_inliers;
    const bool is_enough = is_overwhelming || fit.inliers >= min_share * static_cast<double>(candidates);
    if (!fit.found || fit.margin < kClearMargin || !is_enough) return false;
    const Eigen::Matrix3d turn = RotationAbout<double>(axis.direction, fit.angle_rad);
    AddView(image, station, cam_from_world, {Eigen::Quaterniond(turn), axis.point - turn * axis.point},
            fit.angle_rad);
    report_.mended.push_back({features_.images[static_cast<size_t>(image)].name, how, fit.inliers,
                              static_cast<int>(candidates), fit.margin});
    return true;
  };
  const std::vector<PointInImage> points =
      PointsSeenBy(image, features_, features_.object_pairs, object_points_);
  if (accept(FitTableAngle(CameraOf(image), cam_from_world, axis, points, max_error_px,
                           options_.min_mend_inliers),
             points.size(), options_.min_mend_share,
             "camera from the station, table angle from the object's points")) {
    return true;
  }
  // Matches say less than points: more of them have to agree.
  const std::vector<MatchInPosedImage> matches = MatchesWithPosed(image);
  if (accept(FitTableAngle(CameraOf(image), cam_from_world, axis, matches, 0.5 * max_error_px,
                           options_.min_mend_inliers + 1),
             matches.size(), std::max(0.4, options_.min_mend_share),
             "camera from the station, table angle from matches")) {
    return true;
  }
  return MendByRawMatches(image, cam_from_world, station, 0.5 * max_error_px);
}

// Raw matches are mostly wrong, and neighbouring angles share many right ones: the angle has to have far more
// than chance gives, or be the one that the station's equal steps tell.
bool Refiner::MendByRawMatches(int image, const Rigid3& cam_from_world, int station, double max_error_px) {
  const auto placed = std::count_if(aligned_->scene.views.begin(), aligned_->scene.views.end(),
                                    [&](const View& view) { return view.station == station; });
  if (placed < kMinEqualSteps) return false;
  const std::vector<MatchAcrossTurn> raw = RawMatchesWithPosed(image, cam_from_world);
  const TurntableAxis& axis = aligned_->scene.axis;
  const int least = kOverwhelmingInliers * options_.min_mend_inliers;
  TableAngleFit fit = FitTurn(axis, raw, max_error_px, least);
  if (!fit.found) return false;
  const bool is_clear = fit.margin >= kClearMargin && fit.inliers >= 2 * least &&
                        fit.inliers >= options_.min_mend_share * static_cast<double>(raw.size());
  const std::optional<double> by_steps = AngleByEqualSteps(image);
  if (by_steps) {
    TurnSupport best;
    double angle = *by_steps;
    for (double offset = -2 * kEqualStepBound; offset <= 2 * kEqualStepBound; offset += 0.05 * kDegree) {
      const TurnSupport support = SupportOfTurn(axis, raw, max_error_px, *by_steps + offset);
      if (support.score <= best.score) continue;
      best = support;
      angle = *by_steps + offset;
    }
    if (best.inliers < least || best.score < kStepsSupport * fit.support) return false;
    fit.angle_rad = WrapAngle(angle);
    fit.inliers = best.inliers;
  } else if (!is_clear) {
    return false;
  }
  const Eigen::Matrix3d turn = RotationAbout<double>(axis.direction, fit.angle_rad);
  AddView(image, station, cam_from_world, {Eigen::Quaterniond(turn), axis.point - turn * axis.point},
          fit.angle_rad);
  report_.mended.push_back({features_.images[static_cast<size_t>(image)].name,
                            "camera from the station, table angle from matches that were not verified",
                            fit.inliers, static_cast<int>(raw.size()), fit.margin});
  return true;
}

// The table angle that a station's equal steps give an image, where its other images do lie on a line in the
// order of names.
std::optional<double> Refiner::AngleByEqualSteps(int image) const {
  std::vector<std::pair<int, double>> known;  // place in the order, angle
  int place = 0;
  int place_of_image = 0;
  for (size_t i = 0; i < features_.images.size(); ++i) {
    if (StationOf(static_cast<int>(i)) != StationOf(image)) continue;
    if (static_cast<int>(i) == image) place_of_image = place;
    if (view_of_image_[i] >= 0 && by_steps_.count(static_cast<int>(i)) == 0) {
      known.emplace_back(place,
                         aligned_->scene.views[static_cast<size_t>(view_of_image_[i])].angle_deg * kDegree);
    }
    ++place;
  }
  if (static_cast<int>(known.size()) < kMinEqualSteps) return std::nullopt;
  // Every pair of neighbours proposes a step.
  double best_step = 0;
  double best_offset = 0;
  int best_at = 0;
  size_t most = 0;
  for (size_t k = 1; k < known.size(); ++k) {
    if (known[k].first != known[k - 1].first + 1) continue;
    const double step = WrapAngle(known[k].second - known[k - 1].second);
    const double offset = known[k].second - step * known[k].first;
    size_t agree = 0;
    for (const auto& [at, angle] : known) {
      // The step's own error grows with the distance.
      const double bound = kEqualStepBound * (1 + std::abs(at - known[k].first));
      agree += std::abs(WrapAngle(angle - offset - step * at)) < bound ? 1 : 0;
    }
    if (agree <= most) continue;
    most = agree;
    best_step = step;
    best_offset = offset;
    best_at = known[k].first;
  }
  if (most < 0.8 * static_cast<double>(known.size()) || static_cast<int>(most) < kMinEqualSteps)
    return std::nullopt;
  // A line through what agrees.
  double n = 0;
  double sum_k = 0;
  double sum_kk = 0;
  double sum_r = 0;
  double sum_kr = 0;
  for (const auto& [at, angle] : known) {
    const double r = WrapAngle(angle - best_offset - best_step * at);
    if (std::abs(r) > kEqualStepBound * (1 + std::abs(at - best_at))) continue;
    n += 1;
    sum_k += at;
    sum_kk += at * at;
    sum_r += r;
    sum_kr += at * r;
  }
  const double determinant = n * sum_kk - sum_k * sum_k;
  if (!(determinant > 0)) return std::nullopt;
  const double slope = (n * sum_kr - sum_k * sum_r) / determinant;
  return WrapAngle(best_offset + (sum_r - slope * sum_k) / n + (best_step + slope) * place_of_image);
}

bool Refiner::MendBySteps(int image, const Rigid3& cam_from_world, int station, double max_error_px) {
  const std::optional<double> angle = AngleByEqualSteps(image);
  if (!angle) return false;
  const TurntableAxis& axis = aligned_->scene.axis;
  const Eigen::Matrix3d turn = RotationAbout<double>(axis.direction, *angle);
  const Rigid3 world_from_object{Eigen::Quaterniond(turn), axis.point - turn * axis.point};
  const PosedImage posed{true, &CameraOf(image), cam_from_world * world_from_object};
  const std::vector<MatchInPosedImage> matches = MatchesWithPosed(image);
  int inliers = 0;
  for (const MatchInPosedImage& match : matches) {
    const PosedImage other{true, match.other_camera, match.other_cam_from_object};
    inliers += MatchErrorPx(posed, other, match.xy, match.other_xy) <= max_error_px ? 1 : 0;
  }
  if (inliers < 2 || 2 * inliers < static_cast<int>(matches.size())) return false;
  AddView(image, station, cam_from_world, world_from_object, *angle);
  by_steps_.insert(image);
  report_.mended.push_back({features_.images[static_cast<size_t>(image)].name,
                            "camera from the station, table angle from its equal steps and few matches",
                            inliers, static_cast<int>(matches.size()), 0});
  return true;
}

// Images whose matches contradict their pose, against what the others reach, are taken out; mending may place
// them anew.
void Refiner::DropDoubtful(double max_error_px) {
  const std::vector<PosedImage> posed = Posed(true);
  std::vector<int> agree(posed.size(), 0);
  std::vector<int> all(posed.size(), 0);
  for (const ImagePairMatches& pair : features_.object_pairs) {
    const auto i = static_cast<size_t>(pair.image1);
    const auto j = static_cast<size_t>(pair.image2);
    if (!posed[i].is_posed || !posed[j].is_posed) continue;
    for (const FeatureMatch& match : pair.matches) {
      const bool agrees = MatchErrorPx(posed[i], posed[j], keypoints_[i][match.point2D_idx1].cast<double>(),
                                       keypoints_[j][match.point2D_idx2].cast<double>()) <= max_error_px;
      agree[i] += agrees ? 1 : 0;
      agree[j] += agrees ? 1 : 0;
      ++all[i];
      ++all[j];
    }
  }
  std::vector<double> shares;
  for (size_t i = 0; i < posed.size(); ++i) {
    if (posed[i].is_posed && all[i] > 0) shares.push_back(agree[i] / static_cast<double>(all[i]));
  }
  if (shares.empty()) return;
  const auto middle = shares.begin() + static_cast<std::ptrdiff_t>(shares.size() / 2);
  std::nth_element(shares.begin(), middle, shares.end());
  std::vector<View>& views = aligned_->scene.views;
  std::set<std::string> gone;
  for (size_t i = 0; i < posed.size(); ++i) {
    // An image without matches is where SfM put it for reasons of its own; nothing contradicts it.
    if (!posed[i].is_posed || all[i] < options_.min_mend_inliers) continue;
    if (agree[i] >= kDoubtfulShare * *middle * all[i]) continue;
    const std::string& name = features_.images[i].name;
    gone.insert(name);
  }
  if (gone.empty() || gone.size() * 2 > views.size()) return;
  // The reference image stays: the object's frame is the world's there.
  for (const View& view : views) {
    if (view.angle_deg == 0 && view.world_from_object.Matrix().isIdentity(1e-12)) {
      gone.erase(view.name);
      break;
    }
  }
  views.erase(
      std::remove_if(views.begin(), views.end(), [&](const View& view) { return gone.count(view.name) > 0; }),
      views.end());
  for (const std::string& name : gone) ++drops_[name];
  report_.doubted.insert(report_.doubted.end(), gone.begin(), gone.end());
  IndexViews();
}

// A station that has no view yet: the object's reconstruction places its first image, at table angle 0 by
// definition, or where the background's points say.
int Refiner::NewStation() const {
  int last = -1;
  for (const View& view : aligned_->scene.views) last = std::max(last, view.station);
  return last + 1;
}

bool Refiner::MendStationByObject(const std::vector<int>& images, double max_error_px) {
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
    if (inliers < options_.min_mend_inliers ||
        inliers < options_.min_mend_share * static_cast<double>(points.size())) {
      continue;
    }
    AddView(base, NewStation(), cam_from_object, Rigid3(), 0);
    report_.mended.push_back({features_.images[static_cast<size_t>(base)].name,
                              "its station was placed by the object alone", inliers,
                              static_cast<int>(points.size()), 0});
    return true;
  }
  return false;
}

void Refiner::MendStation(const std::vector<int>& images, double max_error_px) {
  if (MendStationByObject(images, max_error_px)) return;
  // Where the background's reconstruction has one of its photos, another may show enough of the object.
  for (const int base : images) {
    const auto found = aligned_->cam_from_background.find(features_.images[static_cast<size_t>(base)].name);
    if (found == aligned_->cam_from_background.end()) continue;
    const Rigid3 cam_from_world = TransformPose(aligned_->aligned_from_background, found->second);
    const int station = NewStation();
    for (const int image : images) {
      if (MendImage(image, cam_from_world, station, max_error_px)) return;
    }
    break;
  }
}

void Refiner::Mend(double max_error_px) {
  std::map<int, std::vector<int>> missing;  // by station
  std::map<int, int> view_of_station;
  for (size_t i = 0; i < features_.images.size(); ++i) {
    const int station = StationOf(static_cast<int>(i));
    if (view_of_image_[i] < 0) {
      missing[station].push_back(static_cast<int>(i));
    } else {
      view_of_station.emplace(station, view_of_image_[i]);
    }
  }
  for (const auto& [station, images] : missing) {
    if (view_of_station.count(station) == 0) {
      MendStation(images, max_error_px);
      for (const int image : images) {
        if (view_of_image_[static_cast<size_t>(image)] >= 0) {
          view_of_station.emplace(station, view_of_image_[static_cast<size_t>(image)]);
        }
      }
    }
    const auto known = view_of_station.find(station);
    if (known == view_of_station.end()) continue;
    for (const int image : images) {
      if (view_of_image_[static_cast<size_t>(image)] >= 0) continue;
      if (drops_[features_.images[static_cast<size_t>(image)].name] >= kMaxDrops) continue;
      const View station_view = aligned_->scene.views[static_cast<size_t>(known->second)];
      if (!MendImage(image, station_view.cam_from_world, station_view.station, max_error_px)) {
        MendBySteps(image, station_view.cam_from_world, station_view.station, max_error_px);
      }
    }
  }
  SortViews();
}

// Matches on the background, each photo where it or its station stands.
std::vector<StationMatches> Refiner::MatchesOfStations() const {
  const std::vector<int> views = ViewsOfCameras();
  const auto pose = [&](int image) -> const Rigid3* {
    const int view = views[static_cast<size_t>(image)];
    return view < 0 ? nullptr : &aligned_->scene.views[static_cast<size_t>(view)].cam_from_world;
  };
  std::map<std::pair<int, int>, StationMatches> by_stations;
  for (const ImagePairMatches& pair : features_.static_pairs) {
    int i = pair.image1;
    int j = pair.image2;
    const bool is_swapped = StationOf(i) > StationOf(j);
    if (is_swapped) std::swap(i, j);
    const Rigid3* first = pose(i);
    const Rigid3* second = pose(j);
    if (StationOf(i) == StationOf(j) || first == nullptr || second == nullptr) continue;
    StationMatches& all = by_stations[{StationOf(i), StationOf(j)}];
    all.station = StationOf(i);
    all.other_station = StationOf(j);
    for (const FeatureMatch& match : pair.matches) {
      const uint32_t of_first = is_swapped ? match.point2D_idx2 : match.point2D_idx1;
      const uint32_t of_second = is_swapped ? match.point2D_idx1 : match.point2D_idx2;
      all.matches.push_back({&CameraOf(i), *first,
                             keypoints_[static_cast<size_t>(i)][of_first].cast<double>(), &CameraOf(j),
                             *second, keypoints_[static_cast<size_t>(j)][of_second].cast<double>()});
    }
  }
  std::vector<StationMatches> result;
  result.reserve(by_stations.size());
  for (auto& [stations, matches] : by_stations) result.push_back(std::move(matches));
  return result;
}

// Turns a station's cameras about the axis and its table angles back: what it sees of the object stays.
void Refiner::TurnStation(int station, const StationTie& tie) {
  const TurntableAxis& axis = aligned_->scene.axis;
  const Eigen::Matrix3d turn = RotationAbout<double>(axis.direction, tie.turn_rad);
  const Rigid3 turned_from_world{Eigen::Quaterniond(turn), axis.point - turn * axis.point};
  const std::string* name = nullptr;
  for (size_t i = 0; i < view_of_image_.size(); ++i) {
    if (view_of_image_[i] < 0 || StationOf(static_cast<int>(i)) != station) continue;
    View& view = aligned_->scene.views[static_cast<size_t>(view_of_image_[i])];
    view.cam_from_world = view.cam_from_world * turned_from_world;
    view.world_from_object = turned_from_world.Inverse() * view.world_from_object;
    view.angle_deg = WrapAngle(view.angle_deg * kDegree - tie.turn_rad) / kDegree;
    if (name == nullptr) name = &view.name;
  }
  if (name == nullptr) return;
  turned_stations_[station] = {*name, "its station was placed by the background's matches", tie.inliers,
                               tie.matches, tie.margin};
}

// Each station may be wrong by its angle about the axis, where the object alone placed it or the background's
// reconstruction failed: matches on the background say where it stands, and whether they do.
void Refiner::PlaceStations(double max_error_px) {
  std::map<int, int> images;  // by station
  int root = -1;
  for (size_t i = 0; i < view_of_image_.size(); ++i) {
    if (view_of_image_[i] < 0) continue;
    const int station = StationOf(static_cast<int>(i));
    ++images[station];
    const View& view = aligned_->scene.views[static_cast<size_t>(view_of_image_[i])];
    if (view.angle_deg == 0 && root < 0) root = station;
  }
  if (images.size() < 2 || images.size() > kMaxTiedStations) return;
  if (root < 0) root = images.begin()->first;
  TieOptions options;
  options.max_error_px = max_error_px;
  const std::vector<StationTie> ties =
      TieStations(images.rbegin()->first + 1, root, aligned_->scene.axis, MatchesOfStations(), options);
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
  has_background_ = stations_of_component[largest] >= 2;
  if (!has_background_) return;
  for (const auto& [station, count] : images) {
    const StationTie& tie = ties[static_cast<size_t>(station)];
    if (tie.component != largest) continue;
    placed_stations_.insert(station);
    if (tie.turn_rad != 0) TurnStation(station, tie);
  }
}

// The object's frame becomes the world's at another image.
void Refiner::MakeReference(const View& reference) {
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

// Photos whose station nothing ties to the others would put the background in two places.
void Refiner::DropUntiedStations() {
  if (!has_background_) {
    std::set<int> stations;
    for (const View& view : aligned_->scene.views) stations.insert(view.station);
    if (stations.size() > 1 && stations.size() <= kMaxTiedStations) {
      reporter_.Warn("nothing on the background ties the " + std::to_string(stations.size()) +
                     " stations to each other: their angles about the axis are unknown");
    }
    return;
  }
  std::vector<View>& views = aligned_->scene.views;
  std::set<int> all;
  for (size_t i = 0; i < view_of_image_.size(); ++i) {
    if (view_of_image_[i] >= 0) all.insert(StationOf(static_cast<int>(i)));
  }
  if (all.size() > kMaxTiedStations) return;
  std::vector<std::string> gone;
  for (size_t i = 0; i < view_of_image_.size(); ++i) {
    if (view_of_image_[i] < 0 || placed_stations_.count(StationOf(static_cast<int>(i))) > 0) continue;
    gone.push_back(features_.images[i].name);
  }
  if (gone.empty()) return;
  const std::set<std::string> names(gone.begin(), gone.end());
  const auto is_reference = [](const View& view) { return view.angle_deg == 0; };
  const bool had_reference = std::any_of(views.begin(), views.end(), is_reference);
  views.erase(std::remove_if(views.begin(), views.end(),
                             [&](const View& view) { return names.count(view.name) > 0; }),
              views.end());
  RemoveImages(gone, &aligned_->object);
  RemoveImages(gone, &aligned_->background);
  report_.untied = gone;
  reporter_.Warn(std::to_string(gone.size()) + " images left out, the first " + gone[0] +
                 ": nothing on the background ties their station to the others");
  IndexViews();
  if (had_reference && std::none_of(views.begin(), views.end(), is_reference)) {
    const View reference = views[0];
    MakeReference(reference);
  }
}

// The points with the longest tracks, and more where an image would have few.
std::vector<size_t> Refiner::PointsToAdjust(const std::vector<TrackPoint>& points, int max_observations,
                                            int max_points) const {
  std::vector<size_t> order(points.size());
  std::iota(order.begin(), order.end(), size_t{0});
  std::stable_sort(order.begin(), order.end(),
                   [&](size_t a, size_t b) { return points[a].track.size() > points[b].track.size(); });
  std::vector<size_t> chosen;
  std::vector<int> seen(features_.images.size(), 0);
  int64_t observations = 0;
  for (const size_t p : order) {
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

std::vector<TrackElement> Refiner::WholeTrack(const TrackPoint& point, bool of_object) const {
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

ColmapModel Refiner::BuildModel(const std::vector<TrackPoint>& points, const std::vector<size_t>& chosen,
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

JointReport Refiner::Adjust(JointModel model, bool covariance) {
  JointOptions options = joint_options_;
  options.model = model;
  options.compute_covariance = covariance;
  return AdjustWith(options);
}

JointReport Refiner::AdjustWith(JointOptions options) {
  options.loss_scale_px = std::max(options.loss_scale_px, kLossSigmas * noise_px_);
  options.max_reprojection_error_px = std::max(options.max_reprojection_error_px, kErrorSigmas * noise_px_);
  options.refine_focal_length &= !holds_cameras_;
  options.refine_extra_params &= !holds_cameras_;
  JointProblem problem = MakeJointProblem(*aligned_);
  JointReport report = AdjustJointly(options, reporter_, &problem);
  bool ran_away = false;
  for (size_t c = 0; c < problem.cameras.size(); ++c) {
    const double before = FocalLengths(aligned_->scene.cameras[c]).x();
    const double after = FocalLengths(problem.cameras[c]).x();
    ran_away |= !(after > before / kMaxFocalChange && after < before * kMaxFocalChange);
  }
  if (ran_away && !holds_cameras_) {
    reporter_.Warn("the focal length cannot be observed: cameras are held as they were");
    holds_cameras_ = true;
    return AdjustWith(options);
  }
  ApplyJointProblem(problem, aligned_);
  return report;
}

// A keypoint that sees a point of one body is that body's; a rotating one none of whose matches agrees with
// the adjusted poses is unknown again.
void Refiner::Relabel(double max_error_px) {
  std::vector<std::vector<KeypointLabel>> labels;
  labels.reserve(features_.images.size());
  std::vector<std::vector<bool>> agrees;
  for (const ScanImage& image : features_.images) {
    labels.push_back(image.labels);
    labels.back().resize(image.keypoints.size(), KeypointLabel::kUnknown);
    agrees.emplace_back(image.keypoints.size(), false);
  }
  // Matches on their epipolar lines.
  const std::vector<PosedImage> posed = Posed(true);
  for (const ImagePairMatches& pair : object_pairs_) {
    const auto i = static_cast<size_t>(pair.image1);
    const auto j = static_cast<size_t>(pair.image2);
    if (!posed[i].is_posed || !posed[j].is_posed) continue;
    for (const FeatureMatch& match : pair.matches) {
      if (MatchErrorPx(posed[i], posed[j], keypoints_[i][match.point2D_idx1].cast<double>(),
                       keypoints_[j][match.point2D_idx2].cast<double>()) > max_error_px) {
        continue;
      }
      agrees[i][match.point2D_idx1] = agrees[j][match.point2D_idx2] = true;
    }
  }
  for (size_t i = 0; i < labels.size(); ++i) {
    if (!posed[i].is_posed) continue;
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

void Refiner::WriteModels() {
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

RefineReport Refiner::Run() {
  IndexViews();
  // First with the tracks of the two reconstructions, each of which fits its own cameras: this brings the two
  // to common ones. Gross errors are pulled in, not cut off.
  if (!aligned_->object.points3D.empty()) {
    JointOptions options = joint_options_;
    options.model = JointModel::kSharedStations;
    options.loss = JointLoss::kHuber;
    options.max_rounds = 1;
    options.function_tolerance = 1e-5;
    options.compute_covariance = false;
    AdjustWith(options);
    reporter_.Debug("adjusted both reconstructions to common cameras");
  }
  if (!features_.static_pairs.empty()) FindUnmoved();

  MeasureNoise();
  const double first_error_px = std::max(options_.max_error_px, ErrorBound(0));
  double max_error_px = first_error_px;
  JointModel model =
      joint_options_.model == JointModel::kAuto ? JointModel::kSharedStations : joint_options_.model;
  int last_observations = 0;
  for (int round = 0; round < options_.max_rounds; ++round) {
    if (reporter_.StopRequested()) throw Interrupted();
    const auto start = std::chrono::steady_clock::now();
    if (round > 0) {
      DropDoubtful(max_error_px);
      TakeRawMatches(max_error_px);
    }
    object_points_ = Triangulate(true, max_error_px);
    for (size_t before = 0; before != aligned_->scene.views.size();) {
      before = aligned_->scene.views.size();
      if (before == features_.images.size()) break;
      // Drawn in, the bound would leave out what shook against its station.
      Mend(first_error_px);
      if (aligned_->scene.views.size() != before) object_points_ = Triangulate(true, max_error_px);
    }
    PlaceStations(round == 0 ? 2 * first_error_px : first_error_px);
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
    }
    IndexViews();

    RefineRound figures;
    figures.images = static_cast<int>(aligned_->scene.views.size());
    figures.object_points = static_cast<int>(object_points_.size());
    figures.background_points = static_cast<int>(background_points_.size());
    figures.object_rms_px = report_.joint.object_rms_px;
    figures.background_rms_px = report_.joint.background_rms_px;
    figures.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
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
  report_.joint = Adjust(model, joint_options_.compute_covariance);
  report_.model = model;
  IndexViews();
  TakeRawMatches(max_error_px);
  object_points_ = Triangulate(true, max_error_px);
  if (has_background_) background_points_ = Triangulate(false, max_error_px);
  WriteModels();
  Relabel(max_error_px);

  std::set<int> stations;
  for (const View& view : aligned_->scene.views) stations.insert(view.station);
  aligned_->scene.num_stations = static_cast<int>(stations.size());
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

}  // namespace

OptionCheck RefineOptions::Check() const {
  const auto fault = [](const char* field, double value, const char* bound) {
    return OptionFault{field, std::to_string(value), bound};
  };
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
  return Refiner(features, object, joint_options, options, reporter, aligned).Run();
}

}  // namespace s2gs
