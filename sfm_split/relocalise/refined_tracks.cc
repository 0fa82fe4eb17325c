#include <algorithm>
#include <map>
#include <numeric>
#include <set>
#include <string>
#include <utility>

#include "sfm_split/adjust/match_errors.h"
#include "sfm_split/adjust/points_apart.h"
#include "sfm_split/evidence/match_noise.h"
#include "sfm_split/relocalise/scan_refiner.h"
#include "sfm_split/relocalise/unmoved_keypoints.h"
#include "sfm_split/split/stations.h"

namespace s2gs {
namespace {

// A judgement: photos of one station, which shook by less than a touched tripod.
constexpr float kMaxShakePx = 8;
// A judgement: an image with fewer keeps every point; 160 errors for six numbers.
constexpr int kMinObservationsPerImage = 80;
constexpr double kLeastErrorPx = 1;    // below, keypoints are dropped that are only badly localised
constexpr double kMaxErrorGrowth = 4;  // of the error bound, where the matches are noisier than it expects

}  // namespace

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
  const std::vector<PosedImage> posed = Posed(true);
  return MatchErrors(posed, AllKeypoints(features_)).Of(pairs);
}

void ScanRefiner::MeasureNoise() {
  if (options_.noise_px > 0) {
    noise_px_ = options_.noise_px;
    return;
  }
  const std::vector<PosedImage> posed = Posed(true);
  const MatchErrors against_poses(posed, AllKeypoints(features_));
  const double range_px = kNoiseRange * options_.max_error_px;
  noise_px_ = MeasureMatchNoise(posed, against_poses, features_.object_pairs, range_px).sigma;
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
  const auto max_unmoved_px = static_cast<float>(StationOptions().max_unmoved_px);
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
                               kMaxShakePx, max_unmoved_px);
      std::set<uint32_t> used;
      for (size_t k = 0; k < chosen.size(); ++k) {
        if (found[k] != kNoKeypoint && used.insert(found[k]).second)
          unmoved_[image][other][chosen[k]] = found[k];
      }
    }
  }
}

// The points with the longest tracks, and more where an image would have few; of the object none that are
// held back: a wrong match of the object's takes nothing from the background.
std::vector<size_t> ScanRefiner::PointsToAdjust(const std::vector<TrackPoint>& points, int max_observations,
                                                int max_points, bool of_object) const {
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
    if (of_object && std::any_of(points[p].track.begin(), points[p].track.end(), is_held_back)) continue;
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

}  // namespace s2gs
