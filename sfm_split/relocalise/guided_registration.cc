#include "sfm_split/relocalise/guided_registration.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <set>
#include <utility>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/number_text.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/matching/descriptor_match.h"
#include "sfm_split/scene/axis_turn.h"
#include "sfm_split/scene/pose_error.h"

namespace s2gs {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr int kMinCommonStations = 3;  // that a similarity of two reconstructions needs
// Of the camera's distance: cameras of two reconstructions that lie farther apart do not fit each other.
constexpr double kMaxMisfit = 0.02;

}  // namespace

OptionCheck GuidedOptions::Check() const {
  const auto fault = [](const char* field, double value, const char* bound) {
    return OptionFault{field, NumberText(value), bound};
  };
  if (max_looks < 1) return fault("max_looks", max_looks, "max_looks >= 1");
  if (num_candidates < 1) return fault("num_candidates", num_candidates, "num_candidates >= 1");
  if (!(max_distance_rad > 0 && max_distance_rad < kPi / 2))
    return fault("max_distance_rad", max_distance_rad, "0 < max_distance_rad < pi / 2");
  if (!(max_view_change_deg > 0 && max_view_change_deg <= 180))
    return fault("max_view_change_deg", max_view_change_deg, "0 < max_view_change_deg <= 180");
  if (!(max_error_px > 0)) return fault("max_error_px", max_error_px, "max_error_px > 0");
  if (!(window_px > 0)) return fault("window_px", window_px, "window_px > 0");
  if (min_inliers < 3) return fault("min_inliers", min_inliers, "min_inliers >= 3");
  if (!(min_margin >= 1)) return fault("min_margin", min_margin, "min_margin >= 1");
  if (!(max_chance > 0 && max_chance <= 1)) return fault("max_chance", max_chance, "0 < max_chance <= 1");
  return std::nullopt;
}

namespace {

// Registers one scene's missing photos.
class Registration {
 public:
  Registration(const ScanFeatures& features, const ReadDescriptors& read_descriptors,
               const GuidedOptions& options, AlignedScene* aligned, std::vector<ImagePairMatches>* pairs)
      : features_(features),
        read_descriptors_(read_descriptors),
        options_(options),
        aligned_(aligned),
        pairs_(pairs) {
    for (size_t i = 0; i < features.images.size(); ++i)
      image_of_name_[features.images[i].name] = static_cast<int>(i);
    for (const View& view : aligned->scene.views) {
      const int image = image_of_name_.at(view.name);
      is_placed_.insert(image);
      view_of_station_.emplace(StationOf(image), view);
    }
    for (size_t p = 0; p < pairs->size(); ++p) place_of_pair_[{(*pairs)[p].image1, (*pairs)[p].image2}] = p;
    aligned_from_background_ = AlignBackground();
  }

  std::vector<GuidedPhoto> Run(Reporter& reporter) {
    std::map<int, Rigid3> missing;  // where the camera stands
    for (size_t i = 0; i < features_.images.size(); ++i) {
      const int image = static_cast<int>(i);
      if (is_placed_.count(image) > 0) continue;
      if (const std::optional<Rigid3> pose = KnownCamera(image)) missing.emplace(image, *pose);
    }
    std::vector<GuidedPhoto> placed;
    if (missing.empty()) return placed;
    DescribeObject();
    for (bool has_grown = true; has_grown;) {
      has_grown = false;
      for (auto entry = missing.begin(); entry != missing.end();) {
        if (reporter.StopRequested()) throw Interrupted();
        const UnplacedPhoto photo = Describe(entry->first, entry->second);
        const GuidedPlacement placement = PlaceByAppearance(looks_, photo, aligned_->scene.axis, options_);
        const ScanImage& image = features_.images[static_cast<size_t>(entry->first)];
        reporter.Debug(image.name + ": " + std::to_string(placement.inliers) + " points agree at " +
                       std::to_string(placement.angle_rad / kDegree) + " degrees, " +
                       std::to_string(placement.other) + " elsewhere, by chance " +
                       std::to_string(placement.chance) + (placement.found ? ": placed" : ""));
        if (!placement.found) {
          ++entry;
          continue;
        }
        Add(entry->first, photo, placement);
        placed.push_back({image.name, placement.inliers, placement.other, placement.chance,
                          static_cast<int>(placement.matches.size())});
        entry = missing.erase(entry);
        has_grown = true;
      }
    }
    std::sort(aligned_->scene.views.begin(), aligned_->scene.views.end(),
              [](const View& a, const View& b) { return a.name < b.name; });
    return placed;
  }

 private:
  int StationOf(int image) const { return features_.images[static_cast<size_t>(image)].station; }

  const Camera& CameraOf(int image) const {
    const uint32_t id = features_.images[static_cast<size_t>(image)].camera_id;
    const Camera* const camera = aligned_->scene.FindCamera(id);
    return camera != nullptr ? *camera : features_.cameras.at(id);
  }

  // From the background's reconstruction to the scene as it was adjusted since, where the cameras that both
  // have fit each other.
  std::optional<Sim3> AlignBackground() const {
    std::vector<Vector3d> in_background;
    std::vector<Vector3d> in_world;
    for (const auto& [station, view] : view_of_station_) {
      for (const View& other : aligned_->scene.views) {
        if (other.station != view.station) continue;
        const auto found = aligned_->cam_from_background.find(other.name);
        if (found == aligned_->cam_from_background.end()) continue;
        in_background.push_back(CameraCentre(found->second));
        in_world.push_back(CameraCentre(other.cam_from_world));
        break;
      }
    }
    if (static_cast<int>(in_world.size()) < kMinCommonStations) return std::nullopt;
    const Sim3Fit fit = FitSim3(in_background, in_world);
    if (fit.status != FitStatus::kOk) return std::nullopt;
    const TurntableAxis& axis = aligned_->scene.axis;
    for (size_t i = 0; i < in_world.size(); ++i) {
      const double misfit = (fit.b_from_a * in_background[i] - in_world[i]).norm();
      if (misfit > kMaxMisfit * (in_world[i] - axis.point).norm()) return std::nullopt;
    }
    return fit.b_from_a;
  }

  std::optional<Rigid3> KnownCamera(int image) const {
    const auto station = view_of_station_.find(StationOf(image));
    if (station != view_of_station_.end()) return station->second.cam_from_world;
    if (!aligned_from_background_) return std::nullopt;
    for (size_t i = 0; i < features_.images.size(); ++i) {
      if (StationOf(static_cast<int>(i)) != StationOf(image)) continue;
      const auto found = aligned_->cam_from_background.find(features_.images[i].name);
      if (found != aligned_->cam_from_background.end())
        return TransformPose(*aligned_from_background_, found->second);
    }
    return std::nullopt;
  }

  const std::vector<uint8_t>& DescriptorsOf(int image) {
    const auto known = descriptors_.find(image);
    if (known != descriptors_.end()) return known->second;
    std::vector<uint8_t>& descriptors = descriptors_[image];
    descriptors = read_descriptors_(image);
    S2GS_INVARIANT(descriptors.size() ==
                   features_.images[static_cast<size_t>(image)].keypoints.size() * kDescriptorSize);
    return descriptors;
  }

  // Looks evenly over each point's track.
  void DescribeObject() {
    std::map<uint32_t, int> image_of_id;
    for (size_t i = 0; i < features_.images.size(); ++i)
      image_of_id[features_.images[i].image_id] = static_cast<int>(i);
    for (const auto& [id, point] : aligned_->object.points3D) {
      const int index = looks_.AddPoint(point.xyz);
      const size_t num = std::min(point.track.size(), static_cast<size_t>(options_.max_looks));
      for (size_t n = 0; n < num; ++n) {
        const ColmapTrackElement& element = point.track[n * point.track.size() / num];
        const Rigid3& pose = aligned_->object.images.at(element.image_id).cam_from_world;
        AddLook(index, image_of_id.at(element.image_id), element.point2D_idx, pose);
      }
    }
  }

  void AddLook(int point, int image, uint32_t keypoint, const Rigid3& cam_from_object) {
    const Vector3d direction = CameraCentre(cam_from_object) - looks_.points()[static_cast<size_t>(point)];
    looks_.Add({point, image, keypoint, direction.normalized().cast<float>()},
               DescriptorsOf(image).data() + size_t{keypoint} * kDescriptorSize);
  }

  UnplacedPhoto Describe(int image, const Rigid3& cam_from_world) {
    const ScanImage& features = features_.images[static_cast<size_t>(image)];
    UnplacedPhoto photo;
    photo.camera = &CameraOf(image);
    photo.cam_from_world = cam_from_world;
    photo.keypoints = &features.keypoints;
    photo.descriptors = DescriptorsOf(image);
    photo.usable.reserve(features.keypoints.size());
    for (const KeypointLabel label : features.labels) photo.usable.push_back(label != KeypointLabel::kStatic);
    photo.usable.resize(features.keypoints.size(), true);
    return photo;
  }

  void Add(int image, const UnplacedPhoto& photo, const GuidedPlacement& placement) {
    const ScanImage& features = features_.images[static_cast<size_t>(image)];
    const Rigid3 world_from_object = TurnAbout(aligned_->scene.axis, placement.angle_rad);
    const Rigid3 cam_from_object = photo.cam_from_world * world_from_object;
    for (const GuidedPlacement::Match& match : placement.matches) {
      const int point = looks_.looks()[match.look].point;
      for (const ObjectAppearance::Look& look : looks_.looks()) {
        if (look.point == point && look.image != image)
          AddMatch(image, match.keypoint, look.image, look.keypoint);
      }
    }
    for (const GuidedPlacement::Match& match : placement.matches)
      AddLook(looks_.looks()[match.look].point, image, match.keypoint, cam_from_object);

    View view;
    view.name = features.name;
    view.camera_id = features.camera_id;
    view.angle_deg = placement.angle_rad / kDegree;
    view.cam_from_world = photo.cam_from_world;
    view.world_from_object = world_from_object;
    const auto station = view_of_station_.find(features.station);
    if (station != view_of_station_.end()) {
      view.station = station->second.station;
    } else {
      for (const View& other : aligned_->scene.views)
        view.station = std::max(view.station, other.station + 1);
      view_of_station_.emplace(features.station, view);
    }
    if (aligned_->scene.FindCamera(features.camera_id) == nullptr)
      aligned_->scene.cameras.push_back(features_.cameras.at(features.camera_id));
    if (!aligned_->background.images.empty()) {
      ColmapImage& in_background = aligned_->background.images[features.image_id];
      in_background.image_id = features.image_id;
      in_background.name = features.name;
      in_background.camera_id = features.camera_id;
      in_background.cam_from_world = photo.cam_from_world;
    }
    aligned_->scene.views.push_back(view);
    is_placed_.insert(image);
  }

  void AddMatch(int image, uint32_t keypoint, int other, uint32_t other_keypoint) {
    const bool is_first = image < other;
    const std::pair<int, int> key = std::minmax(image, other);
    const auto [place, is_new] = place_of_pair_.emplace(key, pairs_->size());
    if (is_new) pairs_->push_back({key.first, key.second, {}});
    FeatureMatches& matches = (*pairs_)[place->second].matches;
    const FeatureMatch match{is_first ? keypoint : other_keypoint, is_first ? other_keypoint : keypoint};
    const auto is_same = [&](const FeatureMatch& known) {
      return known.point2D_idx1 == match.point2D_idx1 && known.point2D_idx2 == match.point2D_idx2;
    };
    if (std::none_of(matches.begin(), matches.end(), is_same)) matches.push_back(match);
  }

  const ScanFeatures& features_;
  const ReadDescriptors& read_descriptors_;
  const GuidedOptions& options_;
  AlignedScene* aligned_;
  std::vector<ImagePairMatches>* pairs_;
  std::map<std::string, int> image_of_name_;
  std::set<int> is_placed_;
  std::map<int, View> view_of_station_;  // in the features' numbers
  std::map<std::pair<int, int>, size_t> place_of_pair_;
  std::map<int, std::vector<uint8_t>> descriptors_;
  std::optional<Sim3> aligned_from_background_;
  ObjectAppearance looks_;
};

}  // namespace

std::vector<GuidedPhoto> RegisterByAppearance(const ScanFeatures& features,
                                              const ReadDescriptors& read_descriptors,
                                              const GuidedOptions& options, Reporter& reporter,
                                              AlignedScene* aligned, std::vector<ImagePairMatches>* pairs) {
  return Registration(features, read_descriptors, options, aligned, pairs).Run(reporter);
}

}  // namespace s2gs
