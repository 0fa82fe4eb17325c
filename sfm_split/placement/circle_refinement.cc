#include "sfm_split/placement/circle_refinement.h"

#include <algorithm>
#include <cmath>
#include <future>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <utility>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/keeping_reporter.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/placement/model_difference.h"
#include "sfm_split/relocalise/likelihood_ascent.h"
#include "sfm_split/relocalise/match_likelihood.h"

namespace s2gs {
namespace {

constexpr double kAgreeingSigmas = 4;     // of an epipolar error
constexpr double kLeastAgreeingPx = 1.5;  // a judgement: where the noise is told too small
constexpr double kNarrower = 0.5;         // a judgement: of a bound, over the one before
constexpr double kRisk = 0.01;            // that chance takes a photo off its place among equal steps
// A judgement: half of an adjustment's seconds are one thread's, which two need not wait for one after the
// other; with few threads they would wait for each other's loops.
constexpr int kEnoughThreads = 4;

// Within which matches agree, by the noise of right ones.
double BoundPx(double sigma_px) { return std::max(kAgreeingSigmas * sigma_px, kLeastAgreeingPx); }

}  // namespace

bool MostPhotosSeePoints(const AlignedScene& aligned) {
  std::set<uint32_t> seeing;
  for (const auto& [id, point] : aligned.object.points3D) {
    for (const ColmapTrackElement& element : point.track) seeing.insert(element.image_id);
  }
  return 2 * seeing.size() > aligned.scene.views.size();
}

double CircleRefinement::MoveStations(double sigma_px, AlignedScene* aligned) const {
  const LikelihoodAscent ascent = AscendLikelihood(features_, likelihood_.pairs(), reporter_, aligned);
  if (!(ascent.after > ascent.before)) return sigma_px;
  reporter_.Debug("stations moved to where all matches are likeliest: " + std::to_string(ascent.before) +
                  " to " + std::to_string(ascent.after) + ", noise " + std::to_string(ascent.sigma_px) +
                  " px");
  return ascent.sigma_px;
}

// What all matches, also those that contradict the scene, say of its equal steps.
StepsFinding CircleRefinement::EqualSteps(const TurntableScene& scene) const {
  std::map<std::string, const View*> view_of_name;
  for (const View& view : scene.views) view_of_name[view.name] = &view;
  std::vector<const Camera*> cameras;
  std::vector<const View*> views;
  for (const ScanImage& image : features_.images) {
    const auto view = view_of_name.find(image.name);
    const Camera* const camera = scene.FindCamera(image.camera_id);
    const bool is_posed = view != view_of_name.end() && camera != nullptr;
    cameras.push_back(is_posed ? camera : nullptr);
    views.push_back(is_posed ? view->second : nullptr);
  }
  StepsFinding finding = StepsByMatches(features_, cameras, views, scene.axis, kRisk);
  for (const EqualStepsPrior& steps : finding.steps) {
    reporter_.Debug("steps of " + std::to_string(steps.step_rad / kDegree) + " degrees are equal to " +
                    std::to_string(steps.sigma_rad / kDegree) + " by the matches, which put " +
                    std::to_string(finding.elsewhere.size()) + " photos elsewhere");
  }
  return finding;
}

// With the matches that agree with a circle alone: it needs no others, and where texture is poor most
// verified pairs follow highlights. Adjusted poses know better which agree: once more by them.
void CircleRefinement::RefineAgreeing(const Told& told, JointModel model, ScanCandidate* candidate) const {
  RefineOptions refine = refine_;
  refine.max_error_px = std::min(refine.max_error_px, told.bound_px);
  // Matches that agree are cut off at the bound, and tell no noise.
  refine.noise_px = told.sigma_px;
  refine.equal_steps = told.steps.steps;
  refine.station_turns = told.seen.turns;
  refine.rims = told.seen.rims;
  refine.held_back = held_back_;  // of those that agree all but a few would agree again
  candidate->has_given_steps = !told.steps.steps.empty();
  JointOptions joint = joint_;
  joint.model = model;
  joint.max_reprojection_error_px = std::min(joint.max_reprojection_error_px, told.bound_px);
  ScanFeatures agreeing = features_;
  ChosenMatches matches = MatchesThatAgree(features_, candidate->aligned, told.bound_px);
  refine.chosen_variance = matches.variance;
  agreeing.object_pairs = std::move(matches.pairs);
  agreeing.raw_pairs.clear();
  candidate->aligned.object.points3D.clear();
  const PrincipalPointTest before = candidate->refined.principal_point;
  candidate->refined = RefineScan(agreeing, nullptr, joint, refine, reporter_, &candidate->aligned);
  if (before.accepted && !candidate->refined.principal_point.accepted)
    candidate->refined.principal_point = before;
}

void CircleRefinement::Judge(ScanCandidate* candidate) const {
  candidate->is_usable = MostPhotosSeePoints(candidate->aligned);
  likelihood_.Judge(candidate);
}

// Poses of their own for photos, which their points ask for, cost more than all matches may gain by them.
ScanCandidate CircleRefinement::RefineSimplest(const AlignedScene& aligned, const Told& told) const {
  ScanCandidate candidate;
  candidate.aligned = aligned;
  RefineAgreeing(told, joint_.model, &candidate);
  JointModel model = joint_.model;
  std::optional<TurntableScene> of_their_own;
  if (model == JointModel::kAuto && candidate.refined.model != JointModel::kSharedStations) {
    ScanCandidate shared;
    shared.aligned = aligned;
    RefineAgreeing(told, JointModel::kSharedStations, &shared);
    Judge(&candidate);
    Judge(&shared);
    reporter_.Debug("log-likelihood with poses of " + std::string(JointModelName(candidate.refined.model)) +
                    " " + std::to_string(candidate.log_likelihood) + ", with those of stations " +
                    std::to_string(shared.log_likelihood));
    if (shared.IsBetterThan(candidate)) {
      of_their_own = candidate.aligned.scene;
      candidate = std::move(shared);
      model = JointModel::kSharedStations;
    }
  }
  RefineAgreeing(told, model, &candidate);
  Judge(&candidate);
  if (of_their_own) WidenByDifference(*of_their_own, candidate.aligned.scene, &candidate.refined.joint);
  return candidate;
}

// What poses that are rough lack passes for noise of matches, and a bound for that much takes in features
// that slide over the surface: long tracks of them hold the poses where they are. So narrower bounds are
// tried from the same start, for as long as all matches are likelier and those that are right agree better.
// Within less than their noise poses follow what agrees by chance or slides along: the others then lie
// farther off.
ScanCandidate CircleRefinement::RefineWithin(const AlignedScene& aligned, const Told& told) const {
  // Of pairs alone: what slides evenly agrees among three photos as among two, and long tracks of it with
  // the poses that they hold.
  const auto likelihood = [&](const ScanCandidate& candidate) {
    return LikelihoodOfMatches(features_, candidate.aligned, likelihood_.pairs());
  };
  ScanCandidate best = RefineSimplest(aligned, told);
  MatchLikelihood most = likelihood(best);
  Told narrower = told;
  narrower.bound_px = std::min(told.bound_px, refine_.max_error_px);
  while (best.is_usable) {
    narrower.bound_px *= kNarrower;
    narrower.sigma_px = std::min(told.sigma_px, narrower.bound_px / kAgreeingSigmas);
    ScanCandidate candidate = RefineSimplest(aligned, narrower);
    const MatchLikelihood now = likelihood(candidate);
    if (!candidate.is_usable || !(now.gain > most.gain) || !(now.sigma_px < most.sigma_px)) break;
    reporter_.Debug("within " + std::to_string(narrower.bound_px) + " px, log-likelihood " +
                    std::to_string(most.gain) + " > " + std::to_string(now.gain));
    best = std::move(candidate);
    most = now;
  }
  return best;
}

std::pair<ScanCandidate, ScanCandidate> CircleRefinement::RefineBoth(const AlignedScene& aligned,
                                                                     const Told& about_steps,
                                                                     const Told& free) const {
  if (about_steps.steps.steps.empty()) return {ScanCandidate(), RefineWithin(aligned, free)};
  if (NumThreadsOf(joint_.num_threads) < kEnoughThreads) {
    ScanCandidate first = RefineWithin(aligned, about_steps);
    return {std::move(first), RefineWithin(aligned, free)};
  }
  KeepingReporter keeping(reporter_);
  const CircleRefinement beside(*this, keeping);
  std::future<ScanCandidate> second =
      std::async(std::launch::async, [&] { return beside.RefineWithin(aligned, free); });
  ScanCandidate first = RefineWithin(aligned, about_steps);
  second.wait();
  for (const auto& [level, message] : keeping.messages()) reporter_.Log(level, message);
  return {std::move(first), second.get()};
}

// Whether free angles explain more than they cost. Errors of matches that slide over the surface together
// count as if they were many: by as much as the adjustment with free angles says that they do.
bool CircleRefinement::IsWorthItsAngles(const ScanCandidate& free, const ScanCandidate& about_steps) {
  if (!free.is_usable || !about_steps.is_usable) return !about_steps.is_usable;
  const double cost = free.charge - about_steps.charge;
  const double gain = free.log_likelihood - about_steps.log_likelihood + cost;
  return gain > std::max(1.0, free.refined.priors.data_inflation) * cost;
}

ScanCandidate CircleRefinement::RefineAs(const ScanCandidate& other, const AlignedScene& aligned,
                                         double sigma_px, const SeenBesideMatches& seen) const {
  Told told{sigma_px, BoundPx(sigma_px), {}, seen};
  if (other.has_given_steps) told.steps = EqualSteps(aligned.scene);
  ScanCandidate candidate;
  candidate.aligned = aligned;
  for (int round = 0; round < 2; ++round) RefineAgreeing(told, other.refined.model, &candidate);
  Judge(&candidate);
  return candidate;
}

ScanCandidate CircleRefinement::Refine(const AlignedScene& aligned, double sigma_px, bool may_be_equal,
                                       const SeenBesideMatches& seen) const {
  const double bound_px = BoundPx(sigma_px);
  StepsFinding steps;
  if (may_be_equal) steps = EqualSteps(aligned.scene);
  auto [about_steps, free] =
      RefineBoth(aligned, {sigma_px, bound_px, steps, seen}, {sigma_px, bound_px, {}, seen});
  if (about_steps.is_usable) {
    reporter_.Debug("log-likelihood about equal steps " + std::to_string(about_steps.log_likelihood) +
                    ", with free angles " + std::to_string(free.log_likelihood) + ", which is " +
                    std::to_string(free.refined.priors.data_inflation) + " times too large");
  }
  return IsWorthItsAngles(free, about_steps) ? free : about_steps;
}

}  // namespace s2gs
