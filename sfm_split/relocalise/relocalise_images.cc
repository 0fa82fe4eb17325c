#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <set>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/relocalise/scan_refiner.h"
#include "sfm_split/scene/axis_turn.h"

namespace s2gs {
namespace {

constexpr int kMinEqualSteps = 4;                  // images that tell a station's step
constexpr double kEqualStepBound = 0.7 * kDegree;  // of an angle from the line of equal steps
constexpr double kDoubtfulShare = 0.5;             // of the median share of agreeing matches
constexpr int kMaxDrops = 2;                       // of one image
// An angle is doubtful when another one has more than 1 / this of its support.
constexpr double kClearMargin = 1.5;
// Support so far beyond that of any other angle stands whatever the share of outliers.
constexpr double kOverwhelmingMargin = 4;
constexpr int kOverwhelmingInliers = 4;  // times those that must agree anyway
constexpr double kStepsSupport = 0.85;   // of the best angle's, that the one by equal steps must have

}  // namespace

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

std::vector<MatchInPosedImage> ScanRefiner::MatchesWithPosed(int image) const {
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
std::vector<MatchAcrossTurn> ScanRefiner::RawMatchesWithPosed(int image, const Rigid3& cam_from_world) const {
  const std::vector<PosedImage> posed = Posed(true);
  std::vector<MatchAcrossTurn> result;
  for (const ImagePairMatches& pair : features_.raw_pairs) {
    if (pair.image1 != image && pair.image2 != image) continue;
    const bool is_first = pair.image1 == image;
    const int other = is_first ? pair.image2 : pair.image1;
    const PosedImage& there = posed[static_cast<size_t>(other)];
    if (!there.is_posed) continue;
    const bool same_place = StationOf(image) == StationOf(other);
    const ScanImage& here = features_.images[static_cast<size_t>(image)];
    const ScanImage& over_there = features_.images[static_cast<size_t>(other)];
    for (const FeatureMatch& match : pair.matches) {
      const uint32_t mine = is_first ? match.point2D_idx1 : match.point2D_idx2;
      const uint32_t theirs = is_first ? match.point2D_idx2 : match.point2D_idx1;
      if (IsStatic(here, mine) || IsStatic(over_there, theirs)) continue;
      const Eigen::Vector2f& xy = keypoints_[static_cast<size_t>(image)][mine];
      const Eigen::Vector2f& other_xy = keypoints_[static_cast<size_t>(other)][theirs];
      if (same_place && (xy - other_xy).norm() <= kLeastMovePx) continue;
      result.push_back({&CameraOf(image), cam_from_world, xy.cast<double>(), there.camera,
                        there.cam_from_body, other_xy.cast<double>()});
    }
  }
  return result;
}

bool ScanRefiner::RelocaliseImage(int image, const Rigid3& cam_from_world, int station, double max_error_px) {
  const TurntableAxis& axis = aligned_->scene.axis;
  const auto accept = [&](const TableAngleFit& fit, size_t candidates, double min_share, const char* how) {
    const bool is_overwhelming = fit.margin >= kOverwhelmingMargin &&
                                 fit.inliers >= kOverwhelmingInliers * options_.min_relocalise_inliers;
    const bool is_enough = is_overwhelming || fit.inliers >= min_share * static_cast<double>(candidates);
    if (!fit.found || fit.margin < kClearMargin || !is_enough) return false;
    AddView(image, station, cam_from_world, TurnAbout(axis, fit.angle_rad), fit.angle_rad);
    report_.relocalised.push_back({features_.images[static_cast<size_t>(image)].name, how, fit.inliers,
                                   static_cast<int>(candidates), fit.margin});
    return true;
  };
  const std::vector<PointInImage> points =
      PointsSeenBy(image, features_, features_.object_pairs, object_points_);
  if (accept(FitTableAngle(CameraOf(image), cam_from_world, axis, points, max_error_px,
                           options_.min_relocalise_inliers),
             points.size(), options_.min_relocalise_share,
             "camera from the station, table angle from the object's points")) {
    return true;
  }
  // Matches say less than points: more of them have to agree.
  const std::vector<MatchInPosedImage> matches = MatchesWithPosed(image);
  if (accept(FitTableAngle(CameraOf(image), cam_from_world, axis, matches, 0.5 * max_error_px,
                           options_.min_relocalise_inliers + 1),
             matches.size(), std::max(0.4, options_.min_relocalise_share),
             "camera from the station, table angle from matches")) {
    return true;
  }
  return RelocaliseByRawMatches(image, cam_from_world, station, 0.5 * max_error_px);
}

// A camera's pose against the object, from its points alone.
std::optional<PoseByPoints> ScanRefiner::PoseFromPoints(int image, double max_error_px) const {
  const Camera& camera = CameraOf(image);
  // Raw matches are more, and mostly wrong; but few wrong ones lead to a point, and fewer agree on a pose.
  std::vector<ImagePairMatches> of_image;
  for (const std::vector<ImagePairMatches>* pairs : {&features_.object_pairs, &features_.raw_pairs}) {
    for (const ImagePairMatches& pair : *pairs) {
      if (pair.image1 == image || pair.image2 == image) of_image.push_back(pair);
    }
  }
  std::vector<Eigen::Vector3d> in_object;
  std::vector<Eigen::Vector2d> in_plane;  // z = 1, in pixels
  const double focal = FocalLengths(camera).mean();
  for (const PointInImage& point : PointsSeenBy(image, features_, of_image, object_points_)) {
    const std::optional<Eigen::Vector3d> ray = UnprojectFromImage(camera, point.xy);
    if (!ray) continue;
    in_object.push_back(point.x_in_object);
    in_plane.push_back(focal * ray->hnormalized());
  }
  std::optional<PoseByPoints> pose = FitPoseByPoints(in_object, in_plane, focal, max_error_px,
                                                     kOverwhelmingInliers * options_.min_relocalise_inliers);
  if (pose && pose->inliers < options_.min_relocalise_share * static_cast<double>(in_object.size()))
    return std::nullopt;
  return pose;
}

// The object's points tell all of a camera's pose but the turn about the axis: that is told by its station's
// place, which shaking changes little.
bool ScanRefiner::RelocaliseByPose(int image, const View& of_station, const PoseByPoints& pose) {
  const TurntableAxis& axis = aligned_->scene.axis;
  const double angle_rad =
      AngleAboutAxis(axis, CameraCentre(pose.cam_from_object), CameraCentre(of_station.cam_from_world));
  const Rigid3 world_from_object = TurnAbout(axis, angle_rad);
  const Rigid3 cam_from_world = pose.cam_from_object * world_from_object.Inverse();
  if (!AreCamerasClose(axis, cam_from_world, of_station.cam_from_world, kMaxCameraMisfit)) return false;
  AddView(image, of_station.station, cam_from_world, world_from_object, angle_rad);
  report_.relocalised.push_back({features_.images[static_cast<size_t>(image)].name,
                                 "camera from the object's points, table angle from the station's place",
                                 pose.inliers, pose.candidates, 0});
  return true;
}

// Raw matches are mostly wrong, and neighbouring angles share many right ones: the angle has to have far more
// than chance gives, or be the one that the station's equal steps tell.
bool ScanRefiner::RelocaliseByRawMatches(int image, const Rigid3& cam_from_world, int station,
                                         double max_error_px) {
  const auto placed = std::count_if(aligned_->scene.views.begin(), aligned_->scene.views.end(),
                                    [&](const View& view) { return view.station == station; });
  if (placed < kMinEqualSteps) return false;
  const std::vector<MatchAcrossTurn> raw = RawMatchesWithPosed(image, cam_from_world);
  const TurntableAxis& axis = aligned_->scene.axis;
  const int least = kOverwhelmingInliers * options_.min_relocalise_inliers;
  TableAngleFit fit = FitTurn(axis, raw, max_error_px, least);
  if (!fit.found) return false;
  const bool is_clear = fit.margin >= kClearMargin && fit.inliers >= 2 * least &&
                        fit.inliers >= options_.min_relocalise_share * static_cast<double>(raw.size());
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
  AddView(image, station, cam_from_world, TurnAbout(axis, fit.angle_rad), fit.angle_rad);
  report_.relocalised.push_back({features_.images[static_cast<size_t>(image)].name,
                                 "camera from the station, table angle from matches that were not verified",
                                 fit.inliers, static_cast<int>(raw.size()), fit.margin});
  return true;
}

// The table angle that a station's equal steps give an image, where its other images do lie on a line in the
// order of names.
std::optional<double> ScanRefiner::AngleByEqualSteps(int image) const {
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
  std::vector<Eigen::Vector2d> rest;
  for (const auto& [at, angle] : known) {
    const double r = WrapAngle(angle - best_offset - best_step * at);
    if (std::abs(r) <= kEqualStepBound * (1 + std::abs(at - best_at))) rest.emplace_back(at, r);
  }
  const std::optional<Line> line = FitLine(rest);
  if (!line) return std::nullopt;
  return WrapAngle(best_offset + line->start + (best_step + line->slope) * place_of_image);
}

bool ScanRefiner::RelocaliseBySteps(int image, const Rigid3& cam_from_world, int station,
                                    double max_error_px) {
  const std::optional<double> angle = AngleByEqualSteps(image);
  if (!angle) return false;
  const Rigid3 world_from_object = TurnAbout(aligned_->scene.axis, *angle);
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
  report_.relocalised.push_back({features_.images[static_cast<size_t>(image)].name,
                                 "camera from the station, table angle from its equal steps and few matches",
                                 inliers, static_cast<int>(matches.size()), 0});
  return true;
}

// Takes views out for a while; relocalising may place them anew. The object's frame is the world's at another
// image then, if it was at one that goes.
void ScanRefiner::TakeOut(const std::set<std::string>& gone) {
  std::vector<View>& views = aligned_->scene.views;
  const auto is_gone = [&](const View& view) { return gone.count(view.name) > 0; };
  if (gone.empty() || std::all_of(views.begin(), views.end(), is_gone)) return;
  if (is_gone(*aligned_->scene.Reference())) {
    const View other = *std::find_if_not(views.begin(), views.end(), is_gone);
    MakeReference(other);
  }
  views.erase(std::remove_if(views.begin(), views.end(), is_gone), views.end());
  for (const std::string& name : gone) ++drops_[name];
  report_.doubted.insert(report_.doubted.end(), gone.begin(), gone.end());
  IndexViews();
}

// Images whose matches contradict their pose, against what the others reach, are taken out; relocalising may
// place them anew.
void ScanRefiner::DropDoubtful(double max_error_px) {
  const std::vector<PosedImage> posed = Posed(true);
  std::vector<int> agree(posed.size(), 0);
  std::vector<int> all(posed.size(), 0);
  const std::vector<std::vector<double>> errors = ErrorsOf(features_.object_pairs);
  for (size_t p = 0; p < errors.size(); ++p) {
    const ImagePairMatches& pair = features_.object_pairs[p];
    const auto agreeing = static_cast<int>(std::count_if(
        errors[p].begin(), errors[p].end(), [&](double error_px) { return error_px <= max_error_px; }));
    for (const int image : {pair.image1, pair.image2}) {
      agree[static_cast<size_t>(image)] += agreeing;
      all[static_cast<size_t>(image)] += static_cast<int>(errors[p].size());
    }
  }
  std::vector<double> shares;
  for (size_t i = 0; i < posed.size(); ++i) {
    if (posed[i].is_posed && all[i] > 0) shares.push_back(agree[i] / static_cast<double>(all[i]));
  }
  if (shares.empty()) return;
  const double median = UpperMedian(shares);
  std::set<std::string> gone;
  for (size_t i = 0; i < posed.size(); ++i) {
    // An image without matches is where SfM put it for reasons of its own; nothing contradicts it.
    if (!posed[i].is_posed || all[i] < options_.min_relocalise_inliers) continue;
    if (agree[i] >= kDoubtfulShare * median * all[i]) continue;
    const std::string& name = features_.images[i].name;
    gone.insert(name);
  }
  if (gone.size() * 2 > aligned_->scene.views.size()) return;
  TakeOut(gone);
}

void ScanRefiner::Relocalise(double max_error_px) {
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
      RelocaliseStation(images, max_error_px);
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
      if (RelocaliseImage(image, station_view.cam_from_world, station_view.station, max_error_px)) continue;
      if (cameras_are_free_) {
        const std::optional<PoseByPoints> pose = PoseFromPoints(image, max_error_px);
        if (pose && RelocaliseByPose(image, station_view, *pose)) continue;
      }
      RelocaliseBySteps(image, station_view.cam_from_world, station_view.station, max_error_px);
    }
  }
  SortViews();
}

}  // namespace s2gs
