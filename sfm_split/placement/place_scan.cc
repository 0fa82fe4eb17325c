#include "sfm_split/placement/place_scan.h"

#include <algorithm>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "sfm_split/base/number_text.h"
#include "sfm_split/base/stopwatch.h"
#include "sfm_split/circular_motion/circular_scene.h"
#include "sfm_split/circular_motion/rigged_circle_scene.h"
#include "sfm_split/evidence/scan_evidence.h"
#include "sfm_split/placement/candidate_likelihood.h"
#include "sfm_split/placement/circle_beside_background.h"
#include "sfm_split/placement/circle_refinement.h"
#include "sfm_split/placement/partial_models.h"
#include "sfm_split/placement/pose_finish.h"
#include "sfm_split/relocalise/match_likelihood.h"
#include "sfm_split/single_axis/single_axis_scene.h"
#include "sfm_split/turntable/align_scene.h"

namespace s2gs {
namespace {

constexpr size_t kMostCircles = 2;  // whose stations are moved to where they are likeliest

class Placement {
 public:
  Placement(const ScanFeatures& features, const ColmapModel* background, const PlacementOptions& options,
            Reporter& reporter)
      : features_(features),
        background_(background),
        options_(options),
        reporter_(reporter),
        likelihood_(features),
        circles_(features, likelihood_, options.refine, options.joint, reporter),
        finish_(features, likelihood_, circles_, options, reporter, &watch_, &result_) {}

  ScanPlacement Run(const std::vector<ColmapModel>& objects, const ReadDescriptors& read_descriptors,
                    const ReadGreyPhoto& read_photo);
  ScanPlacement RunCircleAlone(const AlignedScene& circle, const CircularFinding& finding,
                               const ReadGreyPhoto& read_photo);

 private:
  ScanCandidate ByFreeSfm(const ColmapModel& object, const ColmapModel* background, const char* how);
  ScanCandidate ByCircularMotion(const CircularMotion& motion, int placed_stations, AlignedScene aligned);
  void ConsiderCircularMotion(const CircularFinding& finding, AlignedScene aligned);
  ScanCandidate BySingleAxis();
  void TryCircularMotion();
  void TryRiggedCircle();
  void TryFreeSfm(const std::vector<ColmapModel>& objects);
  void Consider(ScanCandidate candidate, const char* name);
  void PlaceMissing(const ReadDescriptors& read_descriptors);
  ScanCandidate AdjustWithMore(const ScanFeatures& features, AlignedScene aligned) const;
  RefineReport Refine(const ScanFeatures& features, const ColmapModel* object, AlignedScene* aligned) const {
    return RefineScan(features, object, options_.joint, options_.refine, reporter_, aligned);
  }
  // Whether poses that are not adjusted yet explain matches better than the best do that place enough photos.
  bool IsWorthAdjusting(const AlignedScene& aligned, double unknowns, bool inside_stations,
                        const char* how) const {
    return !IsEnough(result_.best) ||
           likelihood_.IsWorthAdjusting(aligned, unknowns, inside_stations, how, result_.best, reporter_);
  }
  bool IsEnough(const ScanCandidate& candidate) const {
    return candidate.is_usable && static_cast<double>(candidate.aligned.scene.views.size()) >=
                                      options_.enough_share * static_cast<double>(features_.images.size());
  }

  const ScanFeatures& features_;
  const ColmapModel* background_;
  const PlacementOptions& options_;
  Reporter& reporter_;
  const CandidateLikelihood likelihood_;
  const CircleRefinement circles_;
  Stopwatch watch_;
  TurntableMotion motion_ = TurntableMotion::kTooFewImages;  // as free SfM sees it
  ScanPlacement result_;
  PoseFinish finish_;
};

ScanCandidate Placement::ByFreeSfm(const ColmapModel& object, const ColmapModel* background,
                                   const char* how) {
  ScanCandidate candidate;
  std::map<std::string, int> station_of_image;
  for (const ScanImage& image : features_.images) station_of_image[image.name] = image.station;
  AlignOptions options;
  options.turntable = options_.turntable;
  candidate.aligned = AlignScene(object, background, station_of_image, options);
  const size_t aligned_images = candidate.aligned.scene.views.size();
  if (aligned_images == 0) {
    candidate.finding = std::string(how) + " makes no turntable (" +
                        TurntableMotionName(candidate.aligned.solution.motion) + ")";
    return candidate;
  }
  candidate.refined = Refine(features_, &object, &candidate.aligned);
  candidate.is_usable = true;
  candidate.finding = std::string(how) + " placed " + std::to_string(object.images.size()) + " images, " +
                      std::to_string(aligned_images) + " on one turntable, " +
                      std::to_string(candidate.aligned.scene.views.size()) + " after mending";
  return candidate;
}

ScanCandidate Placement::ByCircularMotion(const CircularMotion& motion, int placed_stations,
                                          AlignedScene aligned) {
  const size_t found = aligned.scene.views.size();
  finish_.AddCircle(aligned);
  const double sigma_px = circles_.MoveStations(motion.sigma_px, &aligned);
  // Angles that the circles have free may follow wrong matches, which seem many where they slide alike.
  ScanCandidate candidate = circles_.Refine(aligned, sigma_px, true, {});
  const auto closed = std::count_if(motion.stations.begin(), motion.stations.end(),
                                    [](const CircularStationFit& fit) { return fit.found && fit.closes; });
  candidate.finding = "circular motion placed " + std::to_string(found) + " images at " +
                      std::to_string(placed_stations) + " stations, " + std::to_string(closed) +
                      " of which close a turn, " + std::to_string(candidate.aligned.scene.views.size()) +
                      " after mending";
  return candidate;
}

// Of motions that matches of pairs do not tell from each other, points of many photos may.
void Placement::ConsiderCircularMotion(const CircularFinding& finding, AlignedScene aligned) {
  Consider(ByCircularMotion(finding.motion, finding.placed_stations, std::move(aligned)), "circular_motion");
  for (const CircularRival& rival : finding.rivals) {
    Consider(ByCircularMotion(rival.motion, rival.placed_stations, rival.aligned), "circular_motion");
  }
}

// Alone, or where free SfM is not enough or explains the matches inside stations less well.
void Placement::TryCircularMotion() {
  CircularFinding finding;
  AlignedScene aligned = SceneFromCircularMotion(features_, options_.circular, reporter_, &finding);
  if (aligned.scene.views.empty()) {
    ScanCandidate none;
    none.finding = "circular motion was not found";
    Consider(std::move(none), "circular_motion");
    return;
  }
  if (options_.path == PlacementPath::kAuto &&
      !IsWorthAdjusting(aligned, UnknownsOf(finding.motion), true, "circular motion")) {
    result_.durations.emplace_back("circular_motion", watch_.Lap());
    return;
  }
  ConsiderCircularMotion(finding, std::move(aligned));
}

// Where the background tells how the stations' cameras stand, all their matches together tell one axis. Which
// of several it is they tell once the stations stand where they are likeliest, and the points: of two circles
// that mirror each other, one has them in front of the cameras.
void Placement::TryRiggedCircle() {
  struct Moved {
    AlignedScene aligned;
    double sigma_px = 0;
    double gain = 0;
  };
  std::vector<AlignedScene> scenes = ScenesFromRiggedCircles(features_, likelihood_.pairs(), *background_,
                                                             options_.circular.noise_px, reporter_);
  if (scenes.size() > kMostCircles) scenes.resize(kMostCircles);
  std::vector<Moved> circles;
  for (AlignedScene& aligned : scenes) {
    const double sigma_px = circles_.MoveStations(options_.circular.noise_px, &aligned);
    const double gain = LikelihoodOfMatches(features_, aligned, likelihood_.pairs()).gain;
    circles.push_back({std::move(aligned), sigma_px, gain});
  }
  std::stable_sort(circles.begin(), circles.end(),
                   [](const Moved& a, const Moved& b) { return a.gain > b.gain; });
  ScanCandidate candidate;
  candidate.finding = "no circle goes with the background's cameras";
  for (const Moved& circle : circles) {
    if (!IsWorthAdjusting(circle.aligned, UnknownsOf(circle.aligned.scene), false,
                          "a circle through the background's cameras")) {
      result_.durations.emplace_back("rigged_circle", watch_.Lap());
      return;
    }
    const size_t found = circle.aligned.scene.views.size();
    finish_.AddCircle(circle.aligned);
    ScanCandidate refined = circles_.Refine(circle.aligned, circle.sigma_px, true, {});
    if (!refined.is_usable) continue;
    candidate = std::move(refined);
    candidate.finding = "a circle through the background's cameras placed " + std::to_string(found) +
                        " images, " + std::to_string(candidate.aligned.scene.views.size()) + " after mending";
    break;
  }
  Consider(std::move(candidate), "rigged_circle");
}

ScanCandidate Placement::BySingleAxis() {
  ScanCandidate candidate;
  SingleAxisSolution solution;
  candidate.aligned = SceneFromSingleAxis(features_, background_, options_.single_axis, reporter_, &solution);
  if (!solution.found) {
    candidate.finding = "the single axis was not found (" + solution.reason + ")";
    return candidate;
  }
  const size_t found = candidate.aligned.scene.views.size();
  candidate.refined = Refine(features_, nullptr, &candidate.aligned);
  candidate.is_usable = true;
  candidate.finding = "the single axis placed " + std::to_string(found) + " images, " +
                      std::to_string(candidate.aligned.scene.views.size()) + " after mending";
  return candidate;
}

void Placement::Consider(ScanCandidate candidate, const char* name) {
  if (candidate.is_usable) {
    likelihood_.Judge(&candidate);
    reporter_.Debug(candidate.finding + ": log-likelihood " + std::to_string(candidate.log_likelihood));
  }
  result_.findings += (result_.findings.empty() ? "" : "; ") + candidate.finding;
  result_.durations.emplace_back(name, watch_.Lap());
  if (!candidate.IsBetterThan(result_.best)) return;
  result_.best = std::move(candidate);
  result_.path = name;
}

void Placement::TryFreeSfm(const std::vector<ColmapModel>& objects) {
  if (objects.empty()) {
    result_.findings = "free SfM found no model of the object";
    return;
  }
  ColmapModel object = objects[0];
  const int joined = JoinPartialModels({objects.begin() + 1, objects.end()}, &object);
  if (joined > 0) {
    reporter_.Info(std::to_string(joined) + " images joined from partial models of the object");
  }
  ScanCandidate candidate = ByFreeSfm(object, background_, "free SfM");
  motion_ = candidate.aligned.solution.motion;
  Consider(std::move(candidate), "free_sfm");
  if (background_ != nullptr && !IsEnough(result_.best)) {
    // The background's reconstruction may be what is wrong.
    Consider(ByFreeSfm(object, nullptr, "free SfM of the object alone"), "free_sfm_object");
  }
}

// Poses with photos that were added, adjusted as they came: where matches that agree with a circle alone led
// to them, all verified ones would lead away again.
ScanCandidate Placement::AdjustWithMore(const ScanFeatures& features, AlignedScene aligned) const {
  const ScanCandidate& best = result_.best;
  if (result_.path == "circular_motion" || result_.path == "rigged_circle") {
    const double sigma_px = LikelihoodOfMatches(features_, best.aligned, likelihood_.pairs()).sigma_px;
    ScanCandidate more = circles_.Refine(aligned, sigma_px, best.has_given_steps, {});
    if (more.is_usable) return more;
  }
  ScanCandidate more;
  more.aligned = std::move(aligned);
  more.aligned.object.points3D.clear();
  more.refined = Refine(features, nullptr, &more.aligned);
  return more;
}

// Photos that are still missing, by what the object's points look like.
void Placement::PlaceMissing(const ReadDescriptors& read_descriptors) {
  ScanCandidate& best = result_.best;
  if (best.aligned.scene.views.size() >= features_.images.size()) return;
  ScanFeatures features = features_;  // gains the matches of photos that are placed here
  while (best.aligned.scene.views.size() < features.images.size()) {
    const size_t before = best.aligned.scene.views.size();
    AlignedScene aligned = best.aligned;
    std::vector<ImagePairMatches> pairs = features.object_pairs;
    const std::vector<GuidedPhoto> placed =
        RegisterByAppearance(features, read_descriptors, options_.guided, reporter_, &aligned, &pairs);
    if (placed.empty()) return;
    reporter_.Info(std::to_string(placed.size()) + " of " + std::to_string(features.images.size() - before) +
                   " missing photos placed by what the object's points look like");
    features.object_pairs = std::move(pairs);
    ScanCandidate more = AdjustWithMore(features, std::move(aligned));
    const double noise = std::max(best.refined.joint.object_rms_px, options_.least_noise_px);
    if (more.aligned.scene.views.size() <= before ||
        more.refined.joint.object_rms_px > options_.max_noise_growth * noise) {
      reporter_.Info("which the adjustment does not bear out: they are left out again");
      return;
    }
    if (best.refined.principal_point.accepted) more.refined.principal_point = best.refined.principal_point;
    more.refined.relocalised.insert(more.refined.relocalised.begin(), best.refined.relocalised.begin(),
                                    best.refined.relocalised.end());
    best.aligned = std::move(more.aligned);
    best.refined = std::move(more.refined);
    result_.guided.insert(result_.guided.end(), placed.begin(), placed.end());
  }
}

ScanPlacement Placement::RunCircleAlone(const AlignedScene& circle, const CircularFinding& finding,
                                        const ReadGreyPhoto& read_photo) {
  const size_t num_photos = features_.images.size();
  const auto fail = [&](const std::string& why) {
    result_.findings = why;
    return std::move(result_);
  };
  if (circle.scene.views.size() < num_photos) return fail("it has no place for all photos");
  ScanCandidate candidate;
  candidate.aligned = circle;
  if (background_ != nullptr && !PutBackgroundBeside(*background_, &candidate.aligned))
    return fail("the background's cameras contradict it");
  RefineOptions refine = options_.refine;
  refine.start_is_rough = true;
  candidate.refined = RefineScan(features_, nullptr, options_.joint, refine, reporter_, &candidate.aligned);
  candidate.is_usable = MostPhotosSeePoints(candidate.aligned);
  candidate.finding = "circular motion in place of free SfM placed " + std::to_string(num_photos) +
                      " images, " + std::to_string(candidate.aligned.scene.views.size()) + " after mending";
  Consider(std::move(candidate), "circle_alone");
  const ScanCandidate& best = result_.best;
  if (!best.is_usable || best.aligned.scene.views.size() < num_photos)
    return fail("its adjustment lost photos");
  if (IsWorthAdjusting(circle, UnknownsOf(finding.motion), true, "circular motion")) {
    ConsiderCircularMotion(finding, circle);
    if (background_ != nullptr && result_.path != "circle_alone") TryRiggedCircle();
    if (best.aligned.scene.views.size() < num_photos) return fail("its adjustment lost photos");
  }
  finish_.FinishWithoutSilhouettes(read_photo);
  result_.evidence = GatherEvidence(features_, best.aligned, best.refined.joint, best.refined.priors.turns,
                                    best.refined.held_back, best.matches, options_.refine.max_error_px);
  result_.durations.emplace_back("evidence", watch_.Lap());
  const ScanVerdict verdict = JudgeScan(*result_.evidence);
  if (verdict.verdict != Verdict::kGood)
    return fail("its adjustment is " + std::string(VerdictName(verdict.verdict)) + ": " + verdict.reasons[0]);
  result_.outcome = PlacementOutcome::kPlaced;
  return std::move(result_);
}

ScanPlacement Placement::Run(const std::vector<ColmapModel>& objects, const ReadDescriptors& read_descriptors,
                             const ReadGreyPhoto& read_photo) {
  const PlacementPath path = options_.path;
  if (path == PlacementPath::kAuto || path == PlacementPath::kFreeSfm) TryFreeSfm(objects);
  if (path == PlacementPath::kAuto || path == PlacementPath::kCircular) TryCircularMotion();
  if (path == PlacementPath::kAuto && background_ != nullptr && result_.path != "free_sfm") TryRiggedCircle();
  if (path == PlacementPath::kSingleAxis || (path == PlacementPath::kAuto && !IsEnough(result_.best))) {
    Consider(BySingleAxis(), "single_axis");
  }
  if (result_.best.is_usable) {
    PlaceMissing(read_descriptors);
    result_.durations.emplace_back("place_missing", watch_.Lap());
    finish_.Finish(read_photo);
    result_.outcome = PlacementOutcome::kPlaced;
  } else if (motion_ == TurntableMotion::kNothingRotates) {
    result_.outcome = PlacementOutcome::kNothingRotates;
  }
  return std::move(result_);
}

}  // namespace

OptionCheck PlacementOptions::Check() const {
  const auto fault = [](const char* field, double value, const char* bound) {
    return OptionFault{field, NumberText(value), bound};
  };
  if (!(enough_share >= 0 && enough_share <= 1)) {
    return fault("enough_share", enough_share, "0 <= enough_share <= 1");
  }
  if (!(max_noise_growth >= 1)) return fault("max_noise_growth", max_noise_growth, "max_noise_growth >= 1");
  if (!(least_noise_px > 0)) return fault("least_noise_px", least_noise_px, "least_noise_px > 0");
  return std::nullopt;
}

ScanPlacement PlaceScan(const ScanFeatures& features, const std::vector<ColmapModel>& objects,
                        const ColmapModel* background, const ReadDescriptors& read_descriptors,
                        const ReadGreyPhoto& read_photo, const PlacementOptions& options,
                        Reporter& reporter) {
  S2GS_INVARIANT(!options.Check());
  return Placement(features, background, options, reporter).Run(objects, read_descriptors, read_photo);
}

ScanPlacement PlaceByCircleAlone(const ScanFeatures& features, const AlignedScene& circle,
                                 const CircularFinding& finding, const ColmapModel* background,
                                 const ReadGreyPhoto& read_photo, const PlacementOptions& options,
                                 Reporter& reporter) {
  S2GS_INVARIANT(!options.Check());
  return Placement(features, background, options, reporter).RunCircleAlone(circle, finding, read_photo);
}

}  // namespace s2gs
