#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <set>
#include <utility>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/matching/descriptor_match.h"
#include "sfm_split/matching/keypoint_grid.h"
#include "sfm_split/relocalise/guided_registration.h"
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
constexpr double kMovePx = 1;        // of an object's point from one angle of the sweep to the next
constexpr double kDotsAtOnce = 2e6;  // keypoints x looks

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

std::vector<Proposal> Without(const std::vector<Proposal>& proposals, const std::vector<Proposal>& some) {
  std::set<std::pair<uint32_t, size_t>> left_out;
  for (const Proposal& proposal : some) left_out.insert({proposal.keypoint, proposal.look});
  std::vector<Proposal> rest;
  for (const Proposal& proposal : proposals) {
    if (left_out.count({proposal.keypoint, proposal.look}) == 0) rest.push_back(proposal);
  }
  return rest;
}

// Angles about the one at which most agree, as far as nowhere in between fewer than a share of these do.
class Peak {
 public:
  Peak(const std::vector<int>& counts, double margin) : num_(static_cast<int>(counts.size())) {
    best_ = static_cast<int>(std::max_element(counts.begin(), counts.end()) - counts.begin());
    const int most = counts[static_cast<size_t>(best_)];
    const auto reach = [&](int way, double least) {
      int steps = 0;
      while (steps + 1 < num_ && counts[static_cast<size_t>(Wrapped(best_ + way * (steps + 1)))] > least)
        ++steps;
      return steps;
    };
    // Where as many agree at several angles, the middle one.
    best_ = Wrapped(best_ + (reach(1, most - 1) - reach(-1, most - 1)) / 2);
    before_ = reach(-1, most / margin);
    after_ = reach(1, most / margin);
  }

  double Best() const { return 2 * kPi * best_ / num_; }
  bool Holds(double angle) const {
    const int at = static_cast<int>(std::lround(angle / (2 * kPi) * num_)) - best_;
    return Wrapped(at) <= after_ || Wrapped(-at) <= before_;
  }

 private:
  int Wrapped(int at) const { return ((at % num_) + num_) % num_; }

  int num_;
  int best_ = 0;
  int before_ = 0;
  int after_ = 0;
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

// A finer angle, then with all that is seen from there.
void Refine(const ObjectAppearance& looks, const UnplacedPhoto& photo, const TurntableAxis& axis,
            const GuidedOptions& options, const Sweep& sweep, const Peak& peak,
            const std::vector<Proposal>& inliers, double* angle,
            std::vector<GuidedPlacement::Match>* matches) {
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
      add(*matches);
    }
    const TableAngleFit fit =
        FitTableAngle(*photo.camera, photo.cam_from_world, axis, points, 2 * options.max_error_px, 3);
    if (fit.found && peak.Holds(fit.angle_rad)) *angle = fit.angle_rad;
    *matches = MatchAt(looks, photo, axis, *angle, options, sweep);
  }
}

}  // namespace

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
  const Peak peak(counts, options.min_margin);
  double angle = peak.Best();
  std::vector<Proposal> inliers;
  placement.inliers = sweep.Count(proposals, angle, &inliers);
  // Points near the axis hardly move, and agree on the flanks of a peak as well: these are an answer of their
  // own only by what does not agree at its top.
  const std::vector<Proposal> others = Without(proposals, inliers);
  double sum = 0;
  int num_others = 0;
  for (int a = 0; a < num_angles; ++a) {
    const double at = 2 * kPi * a / num_angles;
    if (std::abs(WrapAngle(at - angle)) < kDistinctAngles) continue;
    const int count = counts[static_cast<size_t>(a)];
    placement.other = std::max(placement.other, peak.Holds(at) ? sweep.Count(others, at) : count);
    sum += count;
    ++num_others;
  }

  // What chance gives varies with what is seen; the mean over all angles is raised to bound it.
  const double mean = num_others > 0 ? std::max(1.0, 1.5 * sum / num_others) : 1.0;
  placement.chance = num_angles * std::exp(LogPoissonTail(placement.inliers, mean));
  placement.angle_rad = WrapAngle(angle);
  if (placement.inliers < options.min_inliers || placement.chance > options.max_chance ||
      placement.inliers < options.min_margin * placement.other) {
    return placement;
  }
  Refine(looks, photo, axis, options, sweep, peak, inliers, &angle, &placement.matches);
  placement.angle_rad = WrapAngle(angle);
  placement.found = true;
  return placement;
}

}  // namespace s2gs
