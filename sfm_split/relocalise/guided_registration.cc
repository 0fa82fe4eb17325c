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
#include "sfm_split/matching/keypoint_grid.h"
#include "sfm_split/scene/axis_turn.h"
#include "sfm_split/scene/camera_projection.h"
#include "sfm_split/scene/pose_error.h"
#include "sfm_split/turntable/table_angle.h"

namespace s2gs {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

// A judgement: several coarsest steps, less than tables are turned by.
constexpr double kDistinctAngles = 5 * kDegree;
constexpr double kSquaredNorm = 512.0 * 512.0;  // of a descriptor, about
constexpr double kCoarsestStep = 1 * kDegree;   // of the sweep
constexpr double kFinestStep = 0.1 * kDegree;   // 3,600 angles at most
constexpr double kMovePx = 1;          // of an object's point from one angle of the sweep to the next
constexpr double kDotsAtOnce = 2e6;    // keypoints x looks
constexpr int kMinCommonStations = 3;  // that a similarity of two reconstructions needs
// Of the camera's distance: cameras of two reconstructions that lie farther apart do not fit each other.
constexpr double kMaxMisfit = 0.02;

struct Proposal {
  uint32_t keypoint = 0;
  size_t look = 0;
};

std::optional<Vector2d> Project(const Camera& camera, const Vector3d& x_in_cam) {
  Vector2d xy;
  if (!ProjectPoint(camera.model, camera.params.data(), x_in_cam.data(), xy.data())) return std::nullopt;
  return xy;
}

Eigen::MatrixXf Unpack(const uint8_t* bytes, size_t count) {
  using Bytes = Eigen::Map<const Eigen::Matrix<uint8_t, kDescriptorSize, Eigen::Dynamic>>;
  return Bytes(bytes, kDescriptorSize, static_cast<Eigen::Index>(count)).cast<float>();
}

int DotProduct(const uint8_t* a, const uint8_t* b) {
  int dot = 0;
  for (int i = 0; i < kDescriptorSize; ++i) dot += int{a[i]} * int{b[i]};
  return dot;
}

// For each usable keypoint the points that look most like it, by their best look.
std::vector<Proposal> Propose(const ObjectAppearance& looks, const UnplacedPhoto& photo,
                              const GuidedOptions& options) {
  std::vector<Proposal> proposals;
  const size_t num_looks = looks.looks().size();
  if (num_looks == 0) return proposals;
  std::vector<uint32_t> usable;
  for (uint32_t k = 0; k < photo.usable.size(); ++k) {
    if (photo.usable[k]) usable.push_back(k);
  }
  const Eigen::MatrixXf of_looks = Unpack(looks.Descriptor(0), num_looks);
  const auto block = std::max<size_t>(1, static_cast<size_t>(kDotsAtOnce / static_cast<double>(num_looks)));
  const auto least_dot = static_cast<float>(std::cos(options.max_distance_rad) * kSquaredNorm);
  std::vector<std::pair<float, size_t>> best;
  for (size_t begin = 0; begin < usable.size(); begin += block) {
    const size_t end = std::min(usable.size(), begin + block);
    Eigen::MatrixXf of_photo(kDescriptorSize, static_cast<Eigen::Index>(end - begin));
    for (size_t k = begin; k < end; ++k) {
      of_photo.col(static_cast<Eigen::Index>(k - begin)) =
          Unpack(photo.descriptors.data() + size_t{usable[k]} * kDescriptorSize, 1);
    }
    const Eigen::MatrixXf dots = of_looks.transpose() * of_photo;
    for (size_t k = begin; k < end; ++k) {
      const float* of_keypoint = dots.col(static_cast<Eigen::Index>(k - begin)).data();
      best.clear();
      for (size_t look = 0; look < num_looks; ++look) {
        if (of_keypoint[look] >= least_dot) best.emplace_back(-of_keypoint[look], look);
      }
      std::sort(best.begin(), best.end());
      std::set<int> points;
      for (const auto& [dot, look] : best) {
        if (!points.insert(looks.looks()[look].point).second) continue;
        proposals.push_back({usable[k], look});
        if (static_cast<int>(points.size()) == options.num_candidates) break;
      }
    }
  }
  return proposals;
}

// How many proposals fall on their keypoints at each angle of a sweep.
class Sweep {
 public:
  Sweep(const ObjectAppearance& looks, const UnplacedPhoto& photo, const TurntableAxis& axis,
        const GuidedOptions& options)
      : looks_(looks),
        photo_(photo),
        axis_(axis),
        options_(options),
        last_point_(looks.points().size(), 0),
        last_place_(photo.keypoints->size(), 0),
        place_(photo.keypoints->size()) {
    // SIFT gives several keypoints with other orientations at one place: they count once.
    std::map<std::pair<float, float>, uint32_t> places;
    for (size_t k = 0; k < place_.size(); ++k) {
      const Eigen::Vector2f& xy = (*photo.keypoints)[k];
      place_[k] = places.emplace(std::make_pair(xy.x(), xy.y()), static_cast<uint32_t>(k)).first->second;
    }
  }

  bool IsSeen(size_t look, const Vector3d& centre_in_object) const {
    const ObjectAppearance::Look& of_point = looks_.looks()[look];
    const Vector3d direction = centre_in_object - looks_.points()[static_cast<size_t>(of_point.point)];
    return direction.normalized().dot(of_point.seen_from.cast<double>()) >= least_cosine_;
  }

  int Count(const std::vector<Proposal>& proposals, double angle, std::vector<Proposal>* inliers = nullptr) {
    ++stamp_;
    const Rigid3 cam_from_object = photo_.cam_from_world * TurnAbout(axis_, angle);
    const Vector3d centre = CameraCentre(cam_from_object);
    int num_points = 0;
    int num_places = 0;
    for (const Proposal& proposal : proposals) {
      const auto point = static_cast<size_t>(looks_.looks()[proposal.look].point);
      const std::optional<Vector2d> xy = Project(*photo_.camera, cam_from_object * looks_.points()[point]);
      if (!xy) continue;
      const Vector2d there = (*photo_.keypoints)[proposal.keypoint].cast<double>();
      if ((*xy - there).squaredNorm() > options_.max_error_px * options_.max_error_px) continue;
      if (!IsSeen(proposal.look, centre)) continue;
      const uint32_t place = place_[proposal.keypoint];
      if (last_point_[point] != stamp_) ++num_points;
      if (last_place_[place] != stamp_) ++num_places;
      last_point_[point] = last_place_[place] = stamp_;
      if (inliers != nullptr) inliers->push_back(proposal);
    }
    return std::min(num_points, num_places);
  }

 private:
  const ObjectAppearance& looks_;
  const UnplacedPhoto& photo_;
  const TurntableAxis& axis_;
  const GuidedOptions& options_;
  double least_cosine_ = std::cos(options_.max_view_change_deg * kDegree);
  int stamp_ = 0;
  std::vector<int> last_point_;
  std::vector<int> last_place_;
  std::vector<uint32_t> place_;
};

// The turn that moves the farther of the points by kMovePx.
double StepOfSweep(const ObjectAppearance& looks, const UnplacedPhoto& photo, const TurntableAxis& axis) {
  const double distance = (CameraCentre(photo.cam_from_world) - axis.point).cross(axis.direction).norm();
  std::vector<double> radii;
  radii.reserve(looks.points().size());
  for (const Vector3d& x : looks.points()) radii.push_back((x - axis.point).cross(axis.direction).norm());
  const auto far = radii.begin() + static_cast<std::ptrdiff_t>(radii.size() * 9 / 10);
  std::nth_element(radii.begin(), far, radii.end());
  const double px_per_rad = FocalLengths(*photo.camera).maxCoeff() * *far / std::max(distance, *far);
  return std::clamp(kMovePx / std::max(px_per_rad, 1e-9), kFinestStep, kCoarsestStep);
}

// Each point that the photo may show, with the keypoint near its place that looks most like it.
std::vector<GuidedPlacement::Match> MatchAt(const ObjectAppearance& looks, const UnplacedPhoto& photo,
                                            const TurntableAxis& axis, double angle,
                                            const GuidedOptions& options, const Sweep& sweep) {
  const Rigid3 cam_from_object = photo.cam_from_world * TurnAbout(axis, angle);
  const Vector3d centre = CameraCentre(cam_from_object);
  const KeypointGrid grid(*photo.keypoints, static_cast<float>(options.window_px), photo.usable);
  const double least_dot = std::cos(options.max_distance_rad) * kSquaredNorm;
  std::map<uint32_t, std::pair<double, size_t>> best_of_keypoint;  // dot, look
  std::map<int, std::pair<double, uint32_t>> best_of_point;        // dot, keypoint
  for (size_t look = 0; look < looks.looks().size(); ++look) {
    if (!sweep.IsSeen(look, centre)) continue;
    const int point = looks.looks()[look].point;
    const std::optional<Vector2d> xy =
        Project(*photo.camera, cam_from_object * looks.points()[static_cast<size_t>(point)]);
    if (!xy) continue;
    grid.ForEachWithin(
        xy->cast<float>(), static_cast<float>(options.window_px), [&](uint32_t keypoint, float /*squared*/) {
          const int dot = DotProduct(looks.Descriptor(look),
                                     photo.descriptors.data() + size_t{keypoint} * kDescriptorSize);
          if (dot < least_dot) return;
          auto& of_keypoint = best_of_keypoint[keypoint];
          if (dot > of_keypoint.first) of_keypoint = {dot, look};
          auto& of_point = best_of_point[point];
          if (dot > of_point.first) of_point = {dot, keypoint};
        });
  }
  std::vector<GuidedPlacement::Match> matches;
  for (const auto& [keypoint, best] : best_of_keypoint) {
    if (best_of_point.at(looks.looks()[best.second].point).second == keypoint)
      matches.push_back({keypoint, best.second});
  }
  return matches;
}

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

void ObjectAppearance::Add(const Look& look, const uint8_t* descriptor) {
  S2GS_INVARIANT(look.point >= 0 && static_cast<size_t>(look.point) < points_.size());
  looks_.push_back(look);
  descriptors_.insert(descriptors_.end(), descriptor, descriptor + kDescriptorSize);
}

int ObjectAppearance::AddPoint(const Vector3d& x_in_object) {
  points_.push_back(x_in_object);
  return static_cast<int>(points_.size()) - 1;
}

GuidedPlacement PlaceByAppearance(const ObjectAppearance& looks, const UnplacedPhoto& photo,
                                  const TurntableAxis& axis, const GuidedOptions& options) {
  S2GS_INVARIANT(!options.Check());
  S2GS_INVARIANT(photo.descriptors.size() == photo.keypoints->size() * kDescriptorSize);
  S2GS_INVARIANT(photo.usable.size() == photo.keypoints->size());
  GuidedPlacement placement;
  const std::vector<Proposal> proposals = Propose(looks, photo, options);
  if (proposals.empty()) return placement;
  Sweep sweep(looks, photo, axis, options);
  const double step = StepOfSweep(looks, photo, axis);
  const int num_angles = static_cast<int>(std::ceil(2 * kPi / step));
  std::vector<int> counts;
  counts.reserve(static_cast<size_t>(num_angles));
  for (int a = 0; a < num_angles; ++a) counts.push_back(sweep.Count(proposals, 2 * kPi * a / num_angles));
  const auto best = std::max_element(counts.begin(), counts.end()) - counts.begin();
  double angle = 2 * kPi * static_cast<double>(best) / num_angles;
  double sum = 0;
  int num_others = 0;
  for (int a = 0; a < num_angles; ++a) {
    if (std::abs(WrapAngle(2 * kPi * a / num_angles - angle)) < kDistinctAngles) continue;
    placement.other = std::max(placement.other, counts[static_cast<size_t>(a)]);
    sum += counts[static_cast<size_t>(a)];
    ++num_others;
  }

  std::vector<Proposal> inliers;
  placement.inliers = sweep.Count(proposals, angle, &inliers);
  // What chance gives varies with what is seen; the mean over all angles is raised to bound it.
  const double mean = num_others > 0 ? std::max(1.0, 1.5 * sum / num_others) : 1.0;
  placement.chance = num_angles * std::exp(LogPoissonTail(placement.inliers, mean));
  placement.angle_rad = WrapAngle(angle);
  if (placement.inliers < options.min_inliers || placement.chance > options.max_chance ||
      placement.inliers < options.min_margin * placement.other) {
    return placement;
  }
  // Finer, then with all that is seen from there.
  for (int round = 0; round < 2; ++round) {
    std::vector<PointInImage> points;
    const auto add = [&](const auto& pairs) {
      points.reserve(pairs.size());
      for (const auto& pair : pairs) {
        const Eigen::Vector2f& keypoint = (*photo.keypoints)[pair.keypoint];
        points.push_back(
            {looks.points()[static_cast<size_t>(looks.looks()[pair.look].point)], keypoint.cast<double>()});
      }
    };
    if (round == 0) {
      add(inliers);
    } else {
      add(placement.matches);
    }
    const TableAngleFit fit =
        FitTableAngle(*photo.camera, photo.cam_from_world, axis, points, 2 * options.max_error_px, 3);
    if (fit.found && std::abs(WrapAngle(fit.angle_rad - angle)) < kDistinctAngles) angle = fit.angle_rad;
    placement.matches = MatchAt(looks, photo, axis, angle, options, sweep);
  }
  placement.angle_rad = WrapAngle(angle);
  placement.found = true;
  return placement;
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
