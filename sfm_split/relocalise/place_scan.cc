#include "sfm_split/relocalise/place_scan.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/number_text.h"
#include "sfm_split/base/stopwatch.h"
#include "sfm_split/circular_motion/circular_scene.h"
#include "sfm_split/circular_motion/rigged_circle_scene.h"
#include "sfm_split/evidence/scan_evidence.h"
#include "sfm_split/evidence/step_width.h"
#include "sfm_split/relocalise/circle_beside_background.h"
#include "sfm_split/relocalise/likelihood_ascent.h"
#include "sfm_split/relocalise/match_likelihood.h"
#include "sfm_split/relocalise/model_difference.h"
#include "sfm_split/relocalise/partial_models.h"
#include "sfm_split/relocalise/silhouette_ties.h"
#include "sfm_split/relocalise/station_turns.h"
#include "sfm_split/relocalise/triple_likelihood.h"
#include "sfm_split/single_axis/single_axis_scene.h"
#include "sfm_split/turntable/align_scene.h"

namespace s2gs {
namespace {

constexpr double kCertain = 8;              // e^8 to one
constexpr double kCertainDeviations = 3.4;  // of a normal distribution: chance goes beyond once in e^8
constexpr double kAgreeingSigmas = 4;       // of an epipolar error
constexpr double kLeastAgreeingPx = 1.5;    // a judgement: where the noise is told too small
constexpr size_t kMostCircles = 2;          // whose stations are moved to where they are likeliest
constexpr double kHalfAStep = 0.5;          // a turn that closes and one that does not differ by more
constexpr double kRisk = 0.01;              // that chance takes a photo off its place among equal steps

// Half the logarithm of the matches for each unknown of the poses.
double Charge(const ScanCandidate& candidate, double inliers) {
  const auto views = static_cast<double>(candidate.aligned.scene.views.size());
  double angles = views;
  // Angles that lie about given steps are not unknown as far as these tell them.
  if (candidate.has_given_steps) {
    for (const double share : candidate.refined.joint.angle_prior_share) angles -= share;
  }
  double unknowns = angles + 6.0 * candidate.aligned.scene.num_stations;
  if (candidate.refined.model != JointModel::kSharedStations) unknowns += 6 * views;
  return 0.5 * unknowns * std::log(std::max(2.0, inliers));
}

// What poses gain over the true ones in the likelihood of matches that they alone were fitted to, but for a
// chance of e^-8: half of chi squared with a degree of freedom for each unknown.
double GainByFitting(double unknowns) {
  return 0.5 * unknowns + kCertainDeviations * std::sqrt(0.5 * unknowns);
}

// Of a fit of circular motion: how each station's camera stands to the axis, its step or its angles, lenses.
double UnknownsOf(const CircularMotion& motion) {
  auto unknowns = static_cast<double>(motion.cameras.size());
  for (const char is_free : motion.distortion_is_free) unknowns += is_free != 0 ? 1 : 0;
  for (const CircularStationFit& fit : motion.stations) {
    if (!fit.found) continue;
    unknowns += 3 + (motion.steps_are_equal ? 1 : static_cast<double>(fit.angles_rad.size()) - 1);
  }
  return unknowns;
}

// Of a scene that was moved to where its matches are likeliest: poses of stations, a step of each, lenses.
double UnknownsOf(const TurntableScene& scene) {
  return 7.0 * scene.num_stations + static_cast<double>(scene.cameras.size());
}

// Epipolar errors do not tell a motion from one that puts the points behind the cameras: then hardly a photo
// sees any that is left.
bool MostPhotosSeePoints(const AlignedScene& aligned) {
  std::set<uint32_t> seeing;
  for (const auto& [id, point] : aligned.object.points3D) {
    for (const ColmapTrackElement& element : point.track) seeing.insert(element.image_id);
  }
  return 2 * seeing.size() > aligned.scene.views.size();
}

class Placement {
 public:
  Placement(const ScanFeatures& features, const ColmapModel* background, const PlacementOptions& options,
            Reporter& reporter)
      : features_(features),
        background_(background),
        options_(options),
        reporter_(reporter),
        pairs_(PossibleObjectPairs(features, false)),
        pairs_inside_(PossibleObjectPairs(features, true)) {}

  ScanPlacement Run(const std::vector<ColmapModel>& objects, const ReadDescriptors& read_descriptors,
                    const ReadGreyPhoto& read_photo);
  ScanPlacement RunCircleAlone(const AlignedScene& circle, const CircularFinding& finding,
                               const ReadGreyPhoto& read_photo);

 private:
  ScanCandidate ByFreeSfm(const ColmapModel& object, const ColmapModel* background, const char* how);
  double MoveStations(double sigma_px, AlignedScene* aligned) const;
  void RefineAgreeing(double sigma_px, const StepsFinding& steps, JointModel model, ScanCandidate* candidate);
  ScanCandidate RefineSimplest(const AlignedScene& aligned, double sigma_px, const StepsFinding& steps);
  ScanCandidate RefineCircle(const AlignedScene& aligned, double sigma_px, bool steps_are_equal);
  StepsFinding EqualSteps(const TurntableScene& scene) const;
  ScanCandidate ByCircularMotion(const CircularFinding& finding, AlignedScene aligned);
  ScanCandidate BySingleAxis();
  void TryCircularMotion();
  void TryRiggedCircle();
  void TryFreeSfm(const std::vector<ColmapModel>& objects);
  void Consider(ScanCandidate candidate, const char* name);
  void PlaceMissing(const ReadDescriptors& read_descriptors);
  void AdjustToPhotos(const ReadGreyPhoto& read_photo);
  void AskAllMatches();
  void FinishPoses(const ReadGreyPhoto& read_photo);
  bool TurnBySilhouettes(const ReadGreyPhoto& read_photo, const ScanCandidate& from);
  RefineReport Refine(const ScanFeatures& features, const ColmapModel* object, AlignedScene* aligned) {
    RefineOptions refine = options_.refine;
    refine.station_turns = station_turns_;
    return RefineScan(features, object, options_.joint, refine, reporter_, aligned);
  }
  // What is known of the lenses before the matches are looked at.
  double LogPriorOfLenses(const TurntableScene& scene) const;
  // What all poses explain with lenses that there are, less what their unknowns cost.
  double LogLikelihood(const ScanCandidate& candidate) const;
  // Whether poses that are not adjusted yet explain matches better than the best do that place enough photos,
  // by more than their being fitted to these matches alone does.
  bool IsWorthAdjusting(const AlignedScene& aligned, double unknowns, bool inside_stations,
                        const char* how) const;
  bool IsEnough(const ScanCandidate& candidate) const {
    return candidate.is_usable && static_cast<double>(candidate.aligned.scene.views.size()) >=
                                      options_.enough_share * static_cast<double>(features_.images.size());
  }

  const ScanFeatures& features_;
  const ColmapModel* background_;
  const PlacementOptions& options_;
  Reporter& reporter_;
  const std::vector<PossiblePair> pairs_;
  const std::vector<PossiblePair> pairs_inside_;  // stations
  Stopwatch watch_;
  TurntableMotion motion_ = TurntableMotion::kTooFewImages;  // as free SfM sees it
  std::vector<StationTurnPrior> station_turns_;              // that silhouettes told
  std::map<int, double> told_turns_deg_;                     // by station: their standard deviations
  ScanPlacement result_;
};

double Placement::LogPriorOfLenses(const TurntableScene& scene) const {
  double sum = 0;
  for (const Camera& camera : scene.cameras) {
    const auto given = features_.cameras.find(camera.camera_id);
    if (given == features_.cameras.end()) continue;
    sum += LogPriorOfLens(camera, given->second, HasPriorFocal(features_, camera.camera_id));
  }
  return sum;
}

double Placement::LogLikelihood(const ScanCandidate& candidate) const {
  const MatchLikelihood matches = LikelihoodOfMatches(features_, candidate.aligned, pairs_);
  return matches.gain + LogPriorOfLenses(candidate.aligned.scene) - Charge(candidate, matches.inliers);
}

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

// To where all matches are likeliest. Returns the noise of right ones, by these matches where they tell it.
double Placement::MoveStations(double sigma_px, AlignedScene* aligned) const {
  const LikelihoodAscent ascent = AscendLikelihood(features_, pairs_, reporter_, aligned);
  if (!(ascent.after > ascent.before)) return sigma_px;
  reporter_.Debug("stations moved to where all matches are likeliest: " + std::to_string(ascent.before) +
                  " to " + std::to_string(ascent.after) + ", noise " + std::to_string(ascent.sigma_px) +
                  " px");
  return ascent.sigma_px;
}

// What all matches, also those that contradict the scene, say of its equal steps.
StepsFinding Placement::EqualSteps(const TurntableScene& scene) const {
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
// verified pairs follow highlights. Twice, as the adjusted poses know better which agree.
void Placement::RefineAgreeing(double sigma_px, const StepsFinding& steps, JointModel model,
                               ScanCandidate* candidate) {
  const double bound_px = std::max(kAgreeingSigmas * sigma_px, kLeastAgreeingPx);
  RefineOptions refine = options_.refine;
  refine.max_error_px = std::min(refine.max_error_px, bound_px);
  // Matches that agree are cut off at the bound, and tell no noise.
  refine.noise_px = sigma_px;
  refine.equal_steps = steps.steps;
  refine.station_turns = station_turns_;
  candidate->has_given_steps = !steps.steps.empty();
  JointOptions joint = options_.joint;
  joint.model = model;
  PrincipalPointTest cut;
  for (int pass = 0; pass < 2; ++pass) {
    ScanFeatures agreeing = features_;
    agreeing.object_pairs = MatchesThatAgree(features_, candidate->aligned, bound_px);
    agreeing.raw_pairs.clear();
    candidate->aligned.object.points3D.clear();
    candidate->refined = RefineScan(agreeing, nullptr, joint, refine, reporter_, &candidate->aligned);
    if (candidate->refined.principal_point.accepted) cut = candidate->refined.principal_point;
  }
  if (cut.accepted) candidate->refined.principal_point = cut;
  candidate->is_usable = MostPhotosSeePoints(candidate->aligned);
  candidate->log_likelihood = LogLikelihood(*candidate);
}

// Poses of their own for photos, which their points ask for, cost more than all matches may gain by them.
ScanCandidate Placement::RefineSimplest(const AlignedScene& aligned, double sigma_px,
                                        const StepsFinding& steps) {
  ScanCandidate candidate;
  candidate.aligned = aligned;
  RefineAgreeing(sigma_px, steps, options_.joint.model, &candidate);
  if (options_.joint.model != JointModel::kAuto || candidate.refined.model == JointModel::kSharedStations)
    return candidate;
  ScanCandidate shared;
  shared.aligned = aligned;
  RefineAgreeing(sigma_px, steps, JointModel::kSharedStations, &shared);
  reporter_.Debug("log-likelihood with poses of " + std::string(JointModelName(candidate.refined.model)) +
                  " " + std::to_string(candidate.log_likelihood) + ", with those of stations " +
                  std::to_string(shared.log_likelihood));
  if (!shared.IsBetterThan(candidate)) return candidate;
  WidenByDifference(candidate.aligned.scene, shared.aligned.scene, &shared.refined.joint);
  return shared;
}

// Free angles follow wrong matches where right ones are few; equal steps may be those of a turn that does not
// close. Both are adjusted, and the likelihood of all matches decides, in which angles that are free cost
// what is not known of them.
ScanCandidate Placement::RefineCircle(const AlignedScene& aligned, double sigma_px, bool steps_are_equal) {
  ScanCandidate about_steps;
  StepsFinding steps;
  if (steps_are_equal) steps = EqualSteps(aligned.scene);
  if (!steps.steps.empty()) about_steps = RefineSimplest(aligned, sigma_px, steps);
  ScanCandidate free = RefineSimplest(aligned, sigma_px, {});
  // How far the table turned altogether is told by points of three photos where those of two leave it open.
  if (about_steps.is_usable && free.is_usable &&
      StepsTurnedOtherwise(features_, about_steps.aligned, free.aligned) > kHalfAStep) {
    for (ScanCandidate* candidate : {&about_steps, &free}) {
      const double gain = GainOfTriples(features_, candidate->aligned, sigma_px);
      reporter_.Debug("points of three photos: " + std::to_string(gain));
      candidate->log_likelihood += gain;
    }
  }
  if (about_steps.is_usable) {
    reporter_.Debug("log-likelihood about equal steps " + std::to_string(about_steps.log_likelihood) +
                    ", with free angles " + std::to_string(free.log_likelihood));
  }
  return about_steps.IsBetterThan(free) ? about_steps : free;
}

ScanCandidate Placement::ByCircularMotion(const CircularFinding& finding, AlignedScene aligned) {
  const size_t found = aligned.scene.views.size();
  const double sigma_px = MoveStations(finding.motion.sigma_px, &aligned);
  ScanCandidate candidate = RefineCircle(aligned, sigma_px, finding.motion.steps_are_equal);
  const auto closed = std::count_if(finding.motion.stations.begin(), finding.motion.stations.end(),
                                    [](const CircularStationFit& fit) { return fit.found && fit.closes; });
  candidate.finding = "circular motion placed " + std::to_string(found) + " images at " +
                      std::to_string(finding.placed_stations) + " stations, " + std::to_string(closed) +
                      " of which close a turn, " + std::to_string(candidate.aligned.scene.views.size()) +
                      " after mending";
  return candidate;
}

bool Placement::IsWorthAdjusting(const AlignedScene& aligned, double unknowns, bool inside_stations,
                                 const char* how) const {
  if (!IsEnough(result_.best)) return true;
  const std::vector<PossiblePair>& pairs = inside_stations ? pairs_inside_ : pairs_;
  const MatchLikelihood matches = LikelihoodOfMatches(features_, result_.best.aligned, pairs);
  const double here = LikelihoodOfMatches(features_, aligned, pairs).gain + LogPriorOfLenses(aligned.scene);
  double best = matches.gain + LogPriorOfLenses(result_.best.aligned.scene);
  // A pose for each photo follows wrong matches as well, and pays for it.
  if (result_.best.refined.model != JointModel::kSharedStations)
    best -= Charge(result_.best, matches.inliers);
  reporter_.Debug("log-likelihood of the matches" + std::string(inside_stations ? " inside stations" : "") +
                  ": " + std::to_string(best) + ", by " + how + " " + std::to_string(here) + ", of which " +
                  std::to_string(GainByFitting(unknowns)) + " may come of " + std::to_string(unknowns) +
                  " unknowns");
  return here > best + GainByFitting(unknowns) + kCertain;
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
  Consider(ByCircularMotion(finding, std::move(aligned)), "circular_motion");
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
  std::vector<AlignedScene> scenes =
      ScenesFromRiggedCircles(features_, pairs_, *background_, options_.circular.noise_px, reporter_);
  if (scenes.size() > kMostCircles) scenes.resize(kMostCircles);
  std::vector<Moved> circles;
  for (AlignedScene& aligned : scenes) {
    const double sigma_px = MoveStations(options_.circular.noise_px, &aligned);
    const double gain = LikelihoodOfMatches(features_, aligned, pairs_).gain;
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
    ScanCandidate refined = RefineCircle(circle.aligned, circle.sigma_px, true);
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
    candidate.log_likelihood = LogLikelihood(candidate);
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
    aligned.object.points3D.clear();
    RefineReport refined = Refine(features, nullptr, &aligned);
    const double noise = std::max(best.refined.joint.object_rms_px, options_.least_noise_px);
    if (aligned.scene.views.size() <= before ||
        refined.joint.object_rms_px > options_.max_noise_growth * noise) {
      reporter_.Info("which the adjustment does not bear out: they are left out again");
      return;
    }
    if (best.refined.principal_point.accepted) refined.principal_point = best.refined.principal_point;
    refined.mended.insert(refined.mended.begin(), best.refined.mended.begin(), best.refined.mended.end());
    best.aligned = std::move(aligned);
    best.refined = std::move(refined);
    result_.guided.insert(result_.guided.end(), placed.begin(), placed.end());
  }
}

void Placement::AdjustToPhotos(const ReadGreyPhoto& read_photo) {
  ScanCandidate& best = result_.best;
  result_.photos =
      AdjustByPhotos(read_photo, features_, best.refined.held_back, best.refined.priors, options_.joint,
                     best.refined.model, options_.photos, reporter_, &best.aligned, &best.refined.joint);
  const PhotoAdjustment& photos = result_.photos;
  reporter_.Info(
      std::string(photos.is_taken ? "poses by patches of the photos: " : "poses by keypoints: ") +
      photos.finding +
      (photos.facing_finding.empty() ? "" : "; in all photos that they face " + photos.facing_finding));
  result_.durations.emplace_back("photo_tracks", watch_.Lap());
}

// Where matches of highlights leave a station's turn open, patches that it shares with others may tell it, to
// what the adjustment to them states.
void Placement::AskAllMatches() {
  ScanCandidate& best = result_.best;
  std::map<int, double> told_deg = told_turns_deg_;
  const std::vector<double>& sigmas_deg = best.refined.joint.angle_sigma_deg;
  for (size_t v = 0; v < std::min(sigmas_deg.size(), best.aligned.scene.views.size()); ++v) {
    const int station = best.aligned.scene.views[v].station;
    if (result_.photos.tied_stations.count(station) == 0) continue;
    if (!(sigmas_deg[v] > 0)) continue;
    double& told = told_deg.try_emplace(station, sigmas_deg[v]).first->second;
    told = std::max(told, sigmas_deg[v]);
  }
  best.matches = AskMatches(features_, pairs_, best.aligned, told_deg, reporter_, &best.refined.joint);
  result_.durations.emplace_back("ask_matches", watch_.Lap());
}

// Where matches leave a station's turn open, silhouettes may tell it: everything is adjusted anew about what
// they say. False where there is nothing to gain. \param from  poses before they were adjusted to photos.
bool Placement::TurnBySilhouettes(const ReadGreyPhoto& read_photo, const ScanCandidate& from) {
  if (from.refined.model != JointModel::kSharedStations) return false;
  std::set<int> untold;
  for (const auto& [station, sigma_deg] : result_.best.matches.turn_sigma_deg) {
    if (std::isinf(sigma_deg)) untold.insert(station);
  }
  if (untold.empty()) return false;
  SilhouetteTies ties = TieBySilhouettes(read_photo, features_, from.aligned, untold, reporter_);
  result_.durations.emplace_back("silhouettes", watch_.Lap());
  if (ties.priors.empty()) return false;
  const double sigma_px = LikelihoodOfMatches(features_, from.aligned, pairs_).sigma_px;
  station_turns_ = std::move(ties.priors);
  ScanCandidate refined = RefineCircle(ties.aligned, sigma_px, true);
  result_.durations.emplace_back("silhouettes", watch_.Lap());
  if (!refined.is_usable || refined.aligned.scene.views.size() < from.aligned.scene.views.size()) {
    station_turns_.clear();
    return false;
  }
  told_turns_deg_ = std::move(ties.sigma_deg);
  refined.finding = from.finding;
  result_.best = std::move(refined);
  result_.findings += "; silhouettes turned stations that matches had left open";
  return true;
}

void Placement::FinishPoses(const ReadGreyPhoto& read_photo) {
  ScanCandidate before;
  if (read_photo) {
    if (result_.best.aligned.scene.num_stations > 1) before = result_.best;
    AdjustToPhotos(read_photo);
  }
  AskAllMatches();
  if (!before.is_usable || !TurnBySilhouettes(read_photo, before)) return;
  AdjustToPhotos(read_photo);
  AskAllMatches();
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
    Consider(ByCircularMotion(finding, circle), "circular_motion");
    if (background_ != nullptr && result_.path != "circle_alone") TryRiggedCircle();
    if (best.aligned.scene.views.size() < num_photos) return fail("its adjustment lost photos");
  }
  if (read_photo) AdjustToPhotos(read_photo);
  AskAllMatches();
  result_.evidence = GatherEvidence(features_, best.aligned, best.refined.joint, best.refined.held_back,
                                    best.matches, options_.refine.max_error_px);
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
    FinishPoses(read_photo);
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
