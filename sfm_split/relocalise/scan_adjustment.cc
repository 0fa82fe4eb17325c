#include <algorithm>
#include <cmath>
#include <cstddef>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "sfm_split/adjust/principal_point.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/evidence/step_width.h"
#include "sfm_split/joint_system/joint_problem.h"
#include "sfm_split/joint_system/joint_system.h"
#include "sfm_split/relocalise/scan_refiner.h"

// The adjustments of a scan's rounds, and what is known beside the matches: lenses, steps, stated angles.

namespace s2gs {
namespace {

constexpr double kMaxFocalChange = 1.4;  // of a rough adjustment; more: it is not observable yet

}  // namespace

JointReport ScanRefiner::Adjust(JointModel model, bool covariance) {
  JointOptions options = joint_options_;
  options.model = model;
  options.compute_covariance = covariance;
  return AdjustWith(options, false);
}

std::vector<LensPrior> ScanRefiner::LensPriors(const JointProblem& problem) const {
  std::vector<LensPrior> priors;
  for (const Camera& camera : problem.cameras) {
    const Camera& given = features_.cameras.at(camera.camera_id);
    LensPrior prior;
    prior.focal = FocalPriorOf(given, HasPriorFocal(features_, camera.camera_id));
    if (const std::optional<size_t> k = DistortionPlace(given)) prior.distortion = given.params[*k];
    if (photos_are_cut_) prior.principal = CutPhotoPrior(camera, PrincipalPoint(given));
    priors.push_back(prior);
  }
  return priors;
}

std::vector<CapturePlace> ScanRefiner::CapturePlaces(const JointProblem& problem) const {
  std::map<int, int> num_photos;
  std::vector<int> place;
  for (const ScanImage& image : features_.images) place.push_back(num_photos[image.station]++);
  std::vector<CapturePlace> places;
  for (const JointImage& image : problem.images) {
    const int i = image_of_name_.at(image.name);
    places.push_back({StationOf(i), place[static_cast<size_t>(i)], num_photos[StationOf(i)]});
  }
  return places;
}

// By images of the features, the problem's.
std::map<int, int> ScanRefiner::ImagesOf(const JointProblem& problem) const {
  std::map<int, int> problem_image_of;
  for (size_t k = 0; k < problem.images.size(); ++k)
    problem_image_of[image_of_name_.at(problem.images[k].name)] = static_cast<int>(k);
  return problem_image_of;
}

// Steps that were given before, as the scene's angles have them now.
std::vector<EqualStepsPrior> ScanRefiner::GivenSteps(const JointProblem& problem) const {
  const std::map<int, int> problem_image_of = ImagesOf(problem);
  std::map<int, int> num_photos = SizesOfStations(features_);
  std::vector<EqualStepsPrior> result;
  for (const EqualStepsPrior& given : options_.equal_steps) {
    std::vector<AngleAtPlace> angles;
    int station = 0;
    for (const EqualStepsPrior::Place& place : given.places) {
      const auto found = problem_image_of.find(place.image);
      if (found == problem_image_of.end()) continue;
      station = StationOf(place.image);
      angles.push_back({found->second, static_cast<int>(place.steps),
                        problem.images[static_cast<size_t>(found->second)].angle_rad});
    }
    EqualStepsPrior steps = NearestEqualSteps(angles, num_photos[station]);
    if (steps.places.empty()) continue;
    steps.sigma_rad = given.sigma_rad;
    result.push_back(std::move(steps));
  }
  return result;
}

std::vector<StationTurnPrior> ScanRefiner::GivenStationTurns(const JointProblem& problem) const {
  const std::map<int, int> problem_image_of = ImagesOf(problem);
  std::vector<StationTurnPrior> result = options_.station_turns;
  for (StationTurnPrior& turn : result) {
    for (std::vector<StationTurnPrior::Place>* places : {&turn.first, &turn.second}) {
      std::vector<StationTurnPrior::Place> kept;
      for (const StationTurnPrior::Place& place : *places) {
        const auto found = problem_image_of.find(place.image);
        if (found != problem_image_of.end()) kept.push_back({found->second, place.angle_rad});
      }
      *places = std::move(kept);
    }
  }
  return result;
}

std::vector<RimPrior> ScanRefiner::GivenRims(const JointProblem& problem) const {
  std::vector<RimPrior> result;
  for (const RimPrior& given : options_.rims) {
    const int station = StationOf(given.image);
    for (size_t k = 0; k < problem.images.size(); ++k) {
      if (StationOf(image_of_name_.at(problem.images[k].name)) != station) continue;
      result.push_back(given);
      result.back().image = static_cast<int>(k);
      break;
    }
  }
  return result;
}

// How much the data count beside steps that were given is told by an adjustment without them; and angles that
// are stated are compared with its angles.
void ScanRefiner::WeighGivenSteps(JointOptions options, JointProblem* problem) {
  JointProblem free = *problem;
  free.priors.turns.clear();
  options.model = JointModel::kSharedStations;
  const JointReport report = AdjustJointly(options, reporter_, &free);
  problem->priors.data_inflation = DataInflation(free, report);
  free.priors.turns = problem->priors.turns;
  PreferKnownAngles(report, &free);
  problem->priors.turns = free.priors.turns;
}

// Stated angles that the photos bear out stand for equal steps of their stations.
void ScanRefiner::PreferKnownAngles(const JointReport& report, JointProblem* problem) {
  if (options_.stated_angles_deg.empty()) return;
  std::vector<int> stations;
  std::vector<std::optional<double>> stated;
  for (const JointImage& image : problem->images) {
    stations.push_back(StationOf(image_of_name_.at(image.name)));
    const auto found = options_.stated_angles_deg.find(image.name);
    stated.emplace_back();
    if (found != options_.stated_angles_deg.end()) stated.back() = found->second * kDegree;
  }
  report_.known_angles = CompareKnownAngles(*problem, stations, stated, report);
  report_.angle_contradictions.clear();
  for (const KnownAngles& angles : report_.known_angles) {
    if (const auto said = DescribeContradiction(angles, *problem))
      report_.angle_contradictions.push_back(*said);
    if (!angles.is_believed) continue;
    std::vector<EqualStepsPrior>& turns = problem->priors.turns;
    const auto of_station = [&](const EqualStepsPrior& turn) {
      return !turn.places.empty() && stations[static_cast<size_t>(turn.places[0].image)] == angles.station;
    };
    turns.erase(std::remove_if(turns.begin(), turns.end(), of_station), turns.end());
    turns.push_back(angles.prior);
  }
}

JointReport ScanRefiner::AdjustWith(JointOptions options, bool is_rough) {
  if (options.loss_scale_px == 0 && noise_px_ > 0) options.loss_scale_px = LossScalePx(noise_px_);
  options.max_reprojection_error_px = std::max(options.max_reprojection_error_px, kErrorSigmas * noise_px_);
  JointProblem problem = MakeJointProblem(*aligned_);
  problem.priors.lenses = LensPriors(problem);
  problem.priors.chosen_variance = options_.chosen_variance;
  if (problem.free_object && report_.priors.wobble) {
    // How far it wobbles, as the last adjustment found it, which may have had other photos.
    problem.priors.wobble = report_.priors.wobble;
    problem.priors.wobble->harmonics.clear();
  }
  if (!problem.free_object || options.model == JointModel::kWobblingTable)
    problem.priors.turns = GivenSteps(problem);
  if (!problem.free_object) {
    problem.priors.station_turns = GivenStationTurns(problem);
    problem.priors.rims = GivenRims(problem);
  }
  const bool has_given_steps = !problem.priors.turns.empty();
  if (has_given_steps && !problem.free_object && options.compute_covariance)
    WeighGivenSteps(options, &problem);
  JointReport report = AdjustJointly(options, reporter_, &problem);
  if (options.compute_covariance && report.model == JointModel::kSharedStations && !has_given_steps) {
    // What the scan itself says of its steps, now that their errors are known; and how much the data count.
    problem.priors.turns = FindEqualSteps(problem, CapturePlaces(problem), report);
    PreferKnownAngles(report, &problem);
    problem.priors.data_inflation = DataInflation(problem, report);
    if (!problem.priors.turns.empty()) {
      reporter_.Debug("table angles lie about equal steps to " +
                      std::to_string(problem.priors.turns[0].sigma_rad / kDegree) +
                      " degrees; errors count " + std::to_string(problem.priors.data_inflation) + " times");
    }
    options.model = JointModel::kSharedStations;
    report = AdjustJointly(options, reporter_, &problem);
  }
  bool ran_away = false;
  for (size_t c = 0; is_rough && c < problem.cameras.size(); ++c) {
    const double before = FocalLengths(aligned_->scene.cameras[c]).x();
    const double after = FocalLengths(problem.cameras[c]).x();
    // Towards what is known of lenses it comes back, from a start that was wrong.
    const double expected = problem.priors.lenses[c].focal.likeliest.focal_px;
    const bool comes_back = std::abs(std::log(after / expected)) < std::abs(std::log(before / expected));
    ran_away |= !(after > before / kMaxFocalChange && after < before * kMaxFocalChange) && !comes_back;
  }
  if (ran_away && options.refine_focal_length) {
    // SfM's tracks need not tell it; those that are triangulated next may. Where they do not either, what is
    // known of lenses does, and the standard deviation says how little that is.
    reporter_.Debug("the focal length cannot be observed yet");
    options.refine_focal_length = options.refine_extra_params = false;
    return AdjustWith(options, is_rough);
  }
  report_.priors = problem.priors;
  ApplyJointProblem(problem, aligned_);
  return report;
}

}  // namespace s2gs
