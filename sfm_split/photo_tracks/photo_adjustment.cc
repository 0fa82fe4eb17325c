#include "sfm_split/photo_tracks/photo_adjustment.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <utility>
#include <vector>

#include "sfm_split/base/infinity.h"
#include "sfm_split/base/number_text.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/base/stopwatch.h"
#include "sfm_split/joint_system/joint_problem.h"
#include "sfm_split/joint_system/joint_system.h"
#include "sfm_split/photo_tracks/photo_adjuster.h"

namespace s2gs {
namespace {

constexpr double kSigmaOfMedian = 0.849;  // of a coordinate, over the median length of errors in the plane
constexpr double kHalfTolerance = 1e-6;   // of adjustments that only tell whether patches gain
// Of places over an arc: beyond, more of their errors is what bends or is lit otherwise than is noise.
constexpr double kMostOverdispersion = 2;
// Of links between two stations, at least: the rest may be patches of something else.
constexpr double kRightShare = 0.5;
// More than standard deviations that fall are a reason for, where it is not less than what the focal length
// is known to: something else is wrong.
constexpr double kMaxFocalChange = 1.1;
constexpr double kFocalSigmas = 3;

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

std::string PxText(double px) { return NumberText(std::round(1e4 * px) / 1e4) + " px"; }

// Keypoints share errors of their own, a bias of some hundredths of a pixel, which poses that followed them
// explain and better ones do not.
bool Contradict(const HeldBackChange& keypoints, const HeldBackChange& patches) {
  return std::hypot(keypoints.before_px, patches.after_px) < keypoints.after_px;
}

// \param sigmas_px  of the focal lengths before.
bool CamerasHold(const JointProblem& before, const JointProblem& after,
                 const std::vector<double>& sigmas_px) {
  for (size_t c = 0; c < before.cameras.size(); ++c) {
    const double focal_px = FocalLengths(before.cameras[c]).x();
    double most = std::log(kMaxFocalChange);
    if (c < sigmas_px.size() && std::isfinite(sigmas_px[c]))
      most = std::max(most, kFocalSigmas * sigmas_px[c] / focal_px);
    if (!(std::abs(std::log(FocalLengths(after.cameras[c]).x() / focal_px)) < most)) return false;
  }
  return true;
}

// By how far others lie off. What is held (0) or was not computed (negative) stays.
void WidenFocalSigmas(const std::vector<double>& others_px, const std::vector<Camera>& cameras,
                      JointReport* joint) {
  for (size_t c = 0; c < std::min(others_px.size(), joint->focal_sigma_px.size()); ++c) {
    double& sigma_px = joint->focal_sigma_px[c];
    if (sigma_px > 0) sigma_px = std::hypot(sigma_px, others_px[c] - FocalLengths(cameras[c]).x());
  }
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
  const ScanFeatures& features;
  const HeldBackKeypoints& held_back;
  const JointPriors& priors;
  const JointOptions& joint_options;
  const PosesToAdjust& poses;
  const PhotoAdjustmentOptions& options;
};

// By these places. \param min_places  photos with fewer keep the keypoints of points without patches.
PhotoAdjustment AdjustOnce(const AdjustmentInput& input, const std::vector<AlignedTrack>& tracks,
                           PhotosLookedIn looked_in, int min_places, Reporter& reporter,
                           AlignedScene* aligned, JointReport* joint) {
  PhotoAdjustment result;
  result.looked_in = looked_in;
  const auto finish = [&](const std::string& finding) {
    result.finding = finding;
    return result;
  };
  std::vector<double> sigmas;
  for (const AlignedTrack& track : tracks) {
    for (const TrackPlace& place : track.places) {
      sigmas.push_back(place.place.sigma_px);
      result.places_beside += place.is_beside ? 1 : 0;
    }
  }
  result.tracks = static_cast<int>(tracks.size());
  result.places = static_cast<int>(sigmas.size());
  if (sigmas.empty()) return finish("patches of the photos agree nowhere");
  result.sigma_px = UpperMedian(std::move(sigmas));

  PhotoAdjuster adjuster(input.features, input.held_back, input.options, aligned);
  adjuster.SetUp(tracks, input.priors, joint->sigma_px, result.sigma_px, min_places);
  JointOptions by_patches = input.joint_options;
  by_patches.model = input.poses.model;
  by_patches.loss_scale_px = 0;
  std::vector<ErrorPair> errors;
  std::vector<double> log_focal(adjuster.problem().cameras.size(), 0);  // the mean of both halves
  JointOptions of_half = by_patches;
  of_half.compute_covariance = false;
  of_half.function_tolerance = std::max(kHalfTolerance, of_half.function_tolerance);
  of_half.max_rounds = 1;
  JointProblem problem;
  for (const PointSet half : {PointSet::kFirstHalf, PointSet::kSecondHalf}) {
    JointProblem of_rival;
    if (input.poses.rival) {
      of_rival = adjuster.Without(half);
      of_half.model = *input.poses.rival;
      AdjustJointly(of_half, reporter, &of_rival);
      of_half.model = by_patches.model;
    }
    problem = adjuster.Without(half);
    AdjustJointly(of_half, reporter, &problem);
    const std::vector<ErrorPair> of_other =
        adjuster.ErrorsOf(half, input.poses.rival ? of_rival : adjuster.problem(), problem, true);
    errors.insert(errors.end(), of_other.begin(), of_other.end());
    for (size_t c = 0; c < log_focal.size(); ++c)
      log_focal[c] += 0.5 * std::log(FocalLengths(problem.cameras[c]).x());
  }
  result.patches = ChangeOf(errors);
  result.patches.overdispersion = std::max(1.0, kSigmaOfMedian * result.patches.after_px / result.sigma_px);
  const bool has_fallen = result.patches.HasFallen(input.poses.deviations);
  const std::string of_photos = result.looked_in == PhotosLookedIn::kFacing ? "in all photos that they face"
                                                                            : "in photos of their tracks";
  const std::string change = PxText(result.patches.before_px) + " to " + PxText(result.patches.after_px);
  const std::string no_better = "patches do not tell better poses for each other: " + change;
  if (result.patches.HasRisen()) return finish(no_better);
  const bool is_noise = result.patches.overdispersion <= kMostOverdispersion;
  if (result.places_beside > 0 && !is_noise) {
    for (size_t c = 0; has_fallen && c < log_focal.size(); ++c)
      result.refused_focal_px.push_back(std::exp(log_focal[c]));
    return finish("patches are not the same from all around: " + PxText(result.patches.after_px) + ", not " +
                  PxText(result.sigma_px / kSigmaOfMedian));
  }
  adjuster.ActivateAll(&problem);  // from a half's poses on
  JointReport report = AdjustJointly(by_patches, reporter, &problem);
  result.log_sigma_change = LogSigmaChange(*joint, report);
  // Standard deviations know of noise alone.
  const bool is_surer = is_noise && result.log_sigma_change < 0;
  if (!has_fallen && !is_surer) return finish(no_better);
  result.keypoints = ChangeOf(adjuster.ErrorsOf(PointSet::kHeldBack, adjuster.problem(), problem, false));
  if (!has_fallen && !CamerasHold(adjuster.problem(), problem, joint->focal_sigma_px))
    return finish("patches ask for another focal length");
  if (Contradict(result.keypoints, result.patches))
    return finish("keypoints that were held back contradict the patches");
  result.tied_stations = adjuster.TiedStations(problem, result.patches.overdispersion);
  adjuster.Take(&problem);
  *joint = std::move(report);
  result.is_taken = true;
  if (has_fallen) {
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

PhotoAdjustment AdjustByTracks(const FindTracks& find, const ScanFeatures& features,
                               const HeldBackKeypoints& held_back, const JointPriors& priors,
                               const JointOptions& joint_options, const PosesToAdjust& poses,
                               const PhotoAdjustmentOptions& options, Reporter& reporter,
                               AlignedScene* aligned, JointReport* joint) {
  S2GS_INVARIANT(!options.Check() && !joint_options.Check());
  const double start = SteadySeconds();
  const AdjustmentInput input{features, held_back, priors, joint_options, poses, options};
  PhotoAdjustment result = AdjustOnce(input, find(PhotosLookedIn::kFacing), PhotosLookedIn::kFacing,
                                      joint_options.min_free_observations, reporter, aligned, joint);
  if (!result.is_taken && result.places_beside > 0) {
    // What bends or is lit otherwise as it turns is one thing from neighbouring angles only.
    const std::string facing_finding = result.finding;
    const std::vector<double> refused_focal_px = std::move(result.refused_focal_px);
    result = AdjustOnce(input, find(PhotosLookedIn::kTracks), PhotosLookedIn::kTracks,
                        std::numeric_limits<int>::max(), reporter, aligned, joint);
    result.facing_finding = facing_finding;
    result.refused_focal_px = refused_focal_px;
  }
  WidenFocalSigmas(result.refused_focal_px, aligned->scene.cameras, joint);
  result.seconds = SteadySeconds() - start;
  return result;
}

PhotoAdjustment AdjustByPhotos(const ReadGreyPhoto& read, const ScanFeatures& features,
                               const HeldBackKeypoints& held_back, const JointPriors& priors,
                               const JointOptions& joint_options, const PosesToAdjust& poses,
                               const PhotoAdjustmentOptions& options, Reporter& reporter,
                               AlignedScene* aligned, JointReport* joint) {
  const auto find = [&](PhotosLookedIn where) {
    TrackPlacesOptions places = options.places;
    if (where == PhotosLookedIn::kTracks) places.min_facing = 1;
    return AlignTracks(aligned->object, read, places, reporter);
  };
  return AdjustByTracks(find, features, held_back, priors, joint_options, poses, options, reporter, aligned,
                        joint);
}

}  // namespace s2gs
