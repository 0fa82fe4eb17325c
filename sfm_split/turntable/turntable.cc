#include "sfm_split/turntable/turntable.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <random>
#include <set>
#include <utility>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/infinity.h"
#include "sfm_split/base/number_text.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/turntable/axis_sense.h"
#include "sfm_split/turntable/turntable_axis.h"
#include "sfm_split/turntable/turntable_measurement.h"
#include "sfm_split/turntable/turntable_scale.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

std::vector<TurntableMeasurement> Measure(const std::vector<TurntablePose>& poses) {
  std::vector<TurntableMeasurement> all;
  all.reserve(poses.size());
  for (const TurntablePose& pose : poses) {
    TurntableMeasurement measurement;
    const Matrix3d world_from_cam = pose.cam_from_world.rotation.conjugate().toRotationMatrix();
    measurement.a = world_from_cam * pose.cam_from_object.rotation.toRotationMatrix();
    measurement.from_object = -(world_from_cam * pose.cam_from_object.translation);
    measurement.centre = CameraCentre(pose.cam_from_world);
    measurement.station = pose.station;
    all.push_back(measurement);
  }
  return all;
}

std::vector<int> FiniteOnes(const std::vector<TurntableMeasurement>& all) {
  std::vector<int> finite;
  for (size_t t = 0; t < all.size(); ++t) {
    if (all[t].a.allFinite() && all[t].from_object.allFinite() && all[t].centre.allFinite()) {
      finite.push_back(static_cast<int>(t));
    }
  }
  return finite;
}

struct GroupFit {
  TurntableAxisFit axis;
  TurntableOffsetFit offset;
  std::vector<int> inliers;
  bool scale_observable = false;
};

bool ScaleObservable(const TurntableOffsetFit& fit, const TurntableOptions& options) {
  return fit.scale > 0 && fit.singular_values.size() == 6 && fit.singular_values[5] > 3e-7 &&
         fit.scale_sigma <= options.max_scale_sigma_rel * fit.scale;
}

GroupFit FitGroup(const std::vector<TurntableMeasurement>& all, const std::vector<int>& use,
                  std::optional<double> known_scale, const TurntableOptions& options, std::mt19937* rng) {
  GroupFit group;
  group.axis = FitTurntableAxis(all, use, options, rng);
  if (group.axis.num_inliers < 2) return group;
  std::vector<int> on_axis;
  for (const int t : use) {
    if (TurntableAxisResidual(all[t], group.axis.n, group.axis.m) <= group.axis.bound) on_axis.push_back(t);
  }
  group.offset = FitTurntableOffset(all, on_axis, group.axis, known_scale, options, rng);
  group.scale_observable = known_scale.has_value() || ScaleObservable(group.offset, options);
  if (!group.scale_observable) {
    const std::vector<double> singular_values = group.offset.singular_values;
    const double scale_sigma = group.offset.scale_sigma / std::max(std::abs(group.offset.scale), 1e-300);
    group.offset = FitTurntableOffset(all, on_axis, group.axis, 1.0, options, rng);
    group.offset.singular_values = singular_values;
    group.offset.scale_sigma = scale_sigma;
  }
  for (const int t : on_axis) {
    if (TurntableOffsetResidual(all[t], group.offset) <= group.offset.bound) group.inliers.push_back(t);
  }
  return group;
}

int CountDistinctStations(const std::vector<TurntablePose>& poses,
                          const std::vector<TurntableMeasurement>& all, const std::vector<int>& use,
                          double tolerance) {
  std::map<int, std::pair<Vector3d, int>> sums;
  for (const int t : use) {
    auto& [sum, count] = sums.try_emplace(poses[t].station, Vector3d::Zero(), 0).first->second;
    sum += all[t].centre;
    ++count;
  }
  std::vector<Vector3d> distinct;
  for (const auto& [station, sum] : sums) {
    const Vector3d centre = sum.first / sum.second;
    const bool known = std::any_of(distinct.begin(), distinct.end(), [&](const Vector3d& other) {
      return (other - centre).norm() <= tolerance;
    });
    if (!known) distinct.push_back(centre);
  }
  return static_cast<int>(distinct.size());
}

// Whether the axis of the first group stands out of the noise; records what that was judged by.
TurntableMotion JudgeMotion(const TurntableAxisFit& axis, size_t num_images, const TurntableOptions& options,
                            TurntableSolution* solution) {
  solution->rotation_sigma_deg = axis.sigma / kDegree;
  solution->axis_sigma_deg = axis.axis_sigma / kDegree;
  const double q = std::sqrt(std::max(0.0, 1 - axis.spread * axis.spread));
  solution->angle_spread_deg = q > 0 ? std::sqrt(-2 * std::log(q)) / kDegree : kInfinity;
  // Of noise alone the fit takes the direction with the largest spread for the axis: the fewer the images,
  // the larger that looks.
  const double least = (2 + 8 / std::sqrt(static_cast<double>(num_images))) * axis.sigma;
  if (axis.spread < 1e-7 || (axis.num_inliers > 2 && axis.spread < least)) {
    return TurntableMotion::kNothingRotates;
  }
  if (axis.axis_sigma > options.max_axis_sigma_deg * kDegree) return TurntableMotion::kStepsTooSmall;
  return TurntableMotion::kRotates;
}

void RecordScale(const std::vector<TurntablePose>& poses, const std::vector<TurntableMeasurement>& all,
                 const GroupFit& group, TurntableSolution* solution) {
  solution->scale = group.offset.scale;
  solution->scale_observable = group.scale_observable;
  solution->scale_sigma_rel =
      group.scale_observable ? group.offset.scale_sigma / group.offset.scale : group.offset.scale_sigma;
  solution->offset_sigma_rel = group.offset.sigma / group.offset.length;
  solution->point_sigma = group.offset.point_sigma;
  solution->singular_values = group.offset.singular_values;
  if (solution->singular_values.size() == 6) {
    const double smallest = solution->singular_values[5];
    solution->scale_singular_gap = smallest > 3e-7 ? smallest / solution->singular_values[4] : 0;
  }
  const double tolerance =
      std::max(4 * std::hypot(group.offset.centre_sigma, group.offset.sigma), 1e-4 * group.offset.length);
  solution->num_distinct_stations = CountDistinctStations(
      poses, all, group.inliers, std::isfinite(tolerance) ? tolerance : 1e-4 * group.offset.length);
  if (!solution->scale_observable) solution->num_distinct_stations = 1;
}

// Fits of the images `rest` to the newest group; the first group's outliers get theirs too.
void RecordImages(const std::vector<TurntableMeasurement>& all, const std::vector<int>& rest,
                  const GroupFit& group, const TurntableGroup& out, TurntableSolution* solution) {
  const int index = static_cast<int>(solution->groups.size()) - 1;
  const bool first = index == 0;
  const Matrix3d e = BasisWithThirdAxis(out.axis_in_world);
  const Matrix3d f = BasisWithThirdAxis(out.axis_in_object);
  for (const int t : rest) {
    TurntableImageFit& fit = solution->images[t];
    const double axis_error = TurntableAxisResidual(all[t], group.axis.n, group.axis.m);
    const double offset_error = TurntableOffsetResidual(all[t], group.offset);
    const bool inlier = axis_error <= group.axis.bound && offset_error <= group.offset.bound;
    if (!first && !inlier) continue;
    const Matrix3d turn = e.transpose() * all[t].a * f;
    fit.angle_rad = AngleAbout(Vector3d::UnitZ(), turn);
    fit.rotation_residual_deg = axis_error / kDegree;
    fit.offset_residual_rel = offset_error / group.offset.length;
    fit.inlier = inlier;
    fit.group = inlier ? index : -1;
  }
}

// How far each image lies from a group's axis and from where its offset should be, in the group's own bounds.
std::vector<double> MisfitsOf(const std::vector<TurntableMeasurement>& all, const GroupFit& group) {
  std::vector<double> misfits;
  misfits.reserve(all.size());
  for (const TurntableMeasurement& one : all) {
    misfits.push_back(std::max(TurntableAxisResidual(one, group.axis.n, group.axis.m) / group.axis.bound,
                               TurntableOffsetResidual(one, group.offset) / group.offset.bound));
  }
  return misfits;
}

// Whether the images of a further group, in order of names within their stations, are runs that begin and end
// with a jump: an object that was moved lies elsewhere from one photo to the next, and as far from there
// until the end. What a lens or a focal length that is not modelled bends grows slowly and is as small at its
// ends as the bound.
bool IsMoved(const std::vector<TurntablePose>& poses, const std::vector<double>& misfits,
             const std::vector<int>& inliers, size_t num_known) {
  std::map<std::pair<int, std::string>, bool> is_inlier;  // in order of station and name
  std::map<std::pair<int, std::string>, double> misfit_of;
  for (size_t t = 0; t < poses.size(); ++t) {
    if (!std::isfinite(misfits[t])) continue;
    is_inlier[{poses[t].station, poses[t].name}] = false;
    misfit_of[{poses[t].station, poses[t].name}] = misfits[t];
  }
  std::vector<double> of_group;
  for (const int t : inliers) {
    is_inlier[{poses[t].station, poses[t].name}] = true;
    of_group.push_back(misfits[t]);
  }
  const double half = 0.5 * UpperMedian(of_group);
  size_t runs = 0;
  std::set<int> stations;
  const std::pair<const std::pair<int, std::string>, bool>* before = nullptr;
  for (const auto& entry : is_inlier) {
    stations.insert(entry.first.first);
    const bool follows = before != nullptr && before->first.first == entry.first.first;
    if (entry.second && !(follows && before->second)) {
      ++runs;
      if (follows && misfit_of[entry.first] < half) return false;
    }
    if (!entry.second && follows && before->second && misfit_of[before->first] < half) return false;
    before = &entry;
  }
  // Each station may have been taken after the object was moved, and back; images that fit nothing break runs
  // too.
  return runs <= stations.size() + num_known && half > 1;
}

double UpSignOf(const std::vector<TurntablePose>& poses, const std::vector<int>& use, const Vector3d& axis) {
  std::vector<Matrix3d> cam_from_world;
  cam_from_world.reserve(use.size());
  for (const int t : use) cam_from_world.push_back(poses[t].cam_from_world.rotation.toRotationMatrix());
  return AxisUpSign(axis, cam_from_world);
}

Matrix3d WorldFromObjectRotation(const TurntableGroup& group, double angle) {
  return BasisWithThirdAxis(group.axis_in_world) * RotationAbout<double>(Vector3d::UnitZ(), angle) *
         BasisWithThirdAxis(group.axis_in_object).transpose();
}

// Angle 0 at the reference, the first inlier by name: the bases that define angles turn along, for every
// group.
void CountFromReference(const std::vector<TurntablePose>& poses, TurntableSolution* solution) {
  for (size_t t = 0; t < poses.size(); ++t) {
    if (!solution->images[t].inlier || solution->images[t].group != 0) continue;
    if (solution->reference < 0 || poses[t].name < poses[solution->reference].name) {
      solution->reference = static_cast<int>(t);
    }
  }
  const double zero = solution->images[solution->reference].angle_rad;
  for (TurntableImageFit& fit : solution->images) {
    fit.angle_rad = fit.inlier ? WrapAngle(fit.angle_rad - zero) : 0;
  }
  solution->reference_angle_rad = zero;
}

// Steps between images of one station that are next to each other by name.
void MeasureSteps(const std::vector<TurntablePose>& poses, TurntableSolution* solution) {
  std::vector<int> order(poses.size());
  std::iota(order.begin(), order.end(), 0);
  std::sort(order.begin(), order.end(), [&](int i, int j) { return poses[i].name < poses[j].name; });
  std::map<int, int> last;
  std::vector<double> steps;
  for (const int t : order) {
    const TurntableImageFit& fit = solution->images[t];
    if (!fit.inlier || fit.group != 0) continue;
    const auto found = last.find(poses[t].station);
    if (found != last.end()) {
      steps.push_back(WrapAngle(fit.angle_rad - solution->images[found->second].angle_rad) / kDegree);
    }
    last[poses[t].station] = t;
  }
  if (steps.empty()) return;
  int sum = 0;
  for (const double step : steps) sum += step > 0 ? 1 : -1;
  solution->sense = sum > 0 ? 1 : (sum < 0 ? -1 : 0);
  solution->median_step_deg = UpperMedian(steps);
}

}  // namespace

OptionCheck TurntableOptions::Check() const {
  const auto fault = [](const char* field, double value, const char* bound) {
    return OptionFault{field, NumberText(value), bound};
  };
  if (max_seeds < 1) return fault("max_seeds", max_seeds, "max_seeds >= 1");
  if (!(max_seed_error_deg > 0))
    return fault("max_seed_error_deg", max_seed_error_deg, "max_seed_error_deg > 0");
  if (!(max_seed_error_rel > 0))
    return fault("max_seed_error_rel", max_seed_error_rel, "max_seed_error_rel > 0");
  if (!(inlier_sigmas >= 2)) return fault("inlier_sigmas", inlier_sigmas, "inlier_sigmas >= 2");
  if (!(min_outlier_deg >= 0)) return fault("min_outlier_deg", min_outlier_deg, "min_outlier_deg >= 0");
  if (!(min_outlier_rel >= 0)) return fault("min_outlier_rel", min_outlier_rel, "min_outlier_rel >= 0");
  if (!(max_axis_sigma_deg > 0))
    return fault("max_axis_sigma_deg", max_axis_sigma_deg, "max_axis_sigma_deg > 0");
  if (!(max_scale_sigma_rel > 0)) {
    return fault("max_scale_sigma_rel", max_scale_sigma_rel, "max_scale_sigma_rel > 0");
  }
  if (known_scale && !(*known_scale > 0)) return fault("known_scale", *known_scale, "known_scale > 0");
  return std::nullopt;
}

const char* TurntableMotionName(TurntableMotion motion) {
  switch (motion) {
    case TurntableMotion::kRotates:
      return "rotates";
    case TurntableMotion::kNothingRotates:
      return "nothing rotates";
    case TurntableMotion::kStepsTooSmall:
      return "steps too small";
    case TurntableMotion::kTooFewImages:
      return "too few images";
  }
  return "";
}

TurntableSolution SolveTurntable(const std::vector<TurntablePose>& poses, const TurntableOptions& options) {
  S2GS_INVARIANT(!options.Check());
  TurntableSolution solution;
  solution.images.resize(poses.size());
  const std::vector<TurntableMeasurement> all = Measure(poses);
  std::vector<int> rest = FiniteOnes(all);
  std::mt19937 rng(options.random_seed);
  const size_t smallest_group = std::max<size_t>(4, (rest.size() + 9) / 10);

  std::vector<double> misfits;  // of the first group
  std::optional<double> scale = options.known_scale;
  while (solution.groups.empty() ? rest.size() >= 2 : rest.size() >= smallest_group) {
    const GroupFit group = FitGroup(all, rest, scale, options, &rng);
    const bool first = solution.groups.empty();
    if (first) {
      const TurntableMotion motion = JudgeMotion(group.axis, rest.size(), options, &solution);
      if (motion == TurntableMotion::kRotates && group.inliers.size() < 2) break;
      solution.motion = motion;
      if (motion != TurntableMotion::kRotates) return solution;
    } else if (group.inliers.size() < smallest_group || group.axis.axis_sigma > 3 * kDegree ||
               !IsMoved(poses, misfits, group.inliers, solution.groups.size())) {
      break;
    }
    TurntableGroup out;
    const double sign = first ? UpSignOf(poses, group.inliers, group.axis.n)
                              : (group.axis.n.dot(solution.groups[0].axis_in_world) < 0 ? -1.0 : 1.0);
    out.axis_in_world = sign * group.axis.n;
    out.axis_in_object = sign * group.axis.m;
    out.point_in_world = group.offset.a;
    out.point_in_object = group.offset.p / group.offset.scale;
    out.num_images = static_cast<int>(group.inliers.size());
    if (first) {
      scale = group.offset.scale;
      misfits = MisfitsOf(all, group);
      RecordScale(poses, all, group, &solution);
    }
    solution.groups.push_back(out);
    RecordImages(all, rest, group, out, &solution);
    std::vector<int> left;
    for (const int t : rest) {
      if (!solution.images[t].inlier) left.push_back(t);
    }
    rest = left;
  }
  if (solution.groups.empty()) return solution;

  CountFromReference(poses, &solution);
  MeasureSteps(poses, &solution);
  return solution;
}

Sim3 WorldFromObjectAtAngle(const TurntableSolution& solution, int group, double angle_rad) {
  S2GS_INVARIANT(group >= 0 && group < static_cast<int>(solution.groups.size()));
  const TurntableGroup& fit = solution.groups[group];
  const Matrix3d a = WorldFromObjectRotation(fit, angle_rad + solution.reference_angle_rad);
  Sim3 world_from_object;
  world_from_object.scale = solution.scale;
  world_from_object.rotation = Eigen::Quaterniond(a).normalized();
  world_from_object.translation = fit.point_in_world - solution.scale * (a * fit.point_in_object);
  return world_from_object;
}

}  // namespace s2gs
