#include "sfm_split/placement/pose_finish.h"

#include <algorithm>
#include <cmath>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "sfm_split/base/infinity.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/placement/rim_starts.h"
#include "sfm_split/relocalise/match_likelihood.h"
#include "sfm_split/relocalise/silhouette_ties.h"
#include "sfm_split/relocalise/station_turns.h"
#include "sfm_split/rim/scene_rims.h"
#include "sfm_split/scene/camera_model.h"
#include "sfm_split/sweep/swept_points.h"

namespace s2gs {
namespace {

constexpr size_t kMostRimStarts = 2;  // that are adjusted
constexpr double kToldByRim = 3;      // an ellipse's five numbers, less the height and radius of the circle
constexpr int kSurfaceRounds = 4;     // a judgement: bounds the time
// Standard deviation of the axis and of the table's angles that leaves nothing to ask for: a sixth of how far
// the median photo of a good scan may be turned.
constexpr double kSureDeg = 0.05;
// One table in ten wobbles by what photos tell: so many standard deviations are ten times likelier of one.
constexpr double kWobbleDeviations = 2.15;

bool IsSure(const JointReport& joint) {
  std::vector<double> angles;
  for (const double sigma : joint.angle_sigma_deg) {
    if (sigma > 0 && std::isfinite(sigma)) angles.push_back(sigma);
  }
  return joint.axis_direction_sigma_deg >= 0 && joint.axis_direction_sigma_deg < kSureDeg &&
         !angles.empty() && UpperMedian(std::move(angles)) < kSureDeg;
}

}  // namespace

std::map<int, double> TurnsByPatches(const TurntableScene& scene, const JointReport& joint,
                                     const std::set<int>& tied_stations) {
  std::map<int, double> told_deg;
  for (size_t v = 0; v < std::min(joint.angle_sigma_deg.size(), scene.views.size()); ++v) {
    const int station = scene.views[v].station;
    if (tied_stations.count(station) == 0) continue;
    const double sigma_deg =
        std::isinf(joint.angle_sigma_deg[v]) ? joint.turn_sigma_deg[v] : joint.angle_sigma_deg[v];
    if (!(sigma_deg > 0)) continue;
    double& told = told_deg.try_emplace(station, sigma_deg).first->second;
    told = std::max(told, sigma_deg);
  }
  return told_deg;
}

void PoseFinish::AdjustToPhotos(const ReadGreyPhoto& read_photo) {
  ScanCandidate& best = result_.best;
  result_.photos = AdjustByPhotos(read_photo, features_, best.refined.held_back, best.refined.priors,
                                  options_.joint, {best.refined.model, {}}, options_.photos, reporter_,
                                  &best.aligned, &best.refined.joint);
  const PhotoAdjustment& photos = result_.photos;
  reporter_.Info(
      std::string(photos.is_taken ? "poses by patches of the photos: " : "poses by keypoints: ") +
      photos.finding +
      (photos.facing_finding.empty() ? "" : "; in all photos that they face " + photos.facing_finding));
  result_.durations.emplace_back("photo_tracks", watch_.Lap());
  AdjustToSurface(read_photo);
  if (LetTableWobble(read_photo)) AdjustToSurface(read_photo);
}

// Where the poses are not sure yet, the surface between keypoints is asked; again while its patches agree
// better, since few are found from poses that are some pixels off.
void PoseFinish::AdjustToSurface(const ReadGreyPhoto& read_photo) {
  ScanCandidate& best = result_.best;
  double error_px = kInfinity;
  for (int round = 0; round < kSurfaceRounds && !IsSure(best.refined.joint); ++round) {
    const SurfaceSweep swept(best.aligned, read_photo, {}, reporter_);
    if (swept.NumPoints() < static_cast<int>(best.aligned.scene.views.size())) break;
    const auto find = [&](PhotosLookedIn where) { return swept.Tracks(where, reporter_); };
    PhotoAdjustment surface = AdjustByTracks(find, features_, best.refined.held_back, best.refined.priors,
                                             options_.joint, {best.refined.model, {}}, options_.photos,
                                             reporter_, &best.aligned, &best.refined.joint);
    reporter_.Info(std::string("the surface between keypoints ") +
                   (surface.is_taken ? "tells better poses: " : "does not tell better poses: ") +
                   surface.finding);
    if (!surface.is_taken) break;
    const bool has_gained = surface.patches.after_px < error_px;
    error_px = surface.patches.after_px;
    result_.photos = std::move(surface);
    if (!has_gained) break;
  }
  result_.durations.emplace_back("surface", watch_.Lap());
}

// Poses of a table that wobbles (smooth_wobble.h), where patches of either half of the points are borne out
// better by such poses from those of the other half than by a pure turn's from the same. Not asked where
// photos do not ask for object poses of their own: the score of those is 1 of a pure turn. \return  whether
// they are taken.
bool PoseFinish::LetTableWobble(const ReadGreyPhoto& read_photo) {
  ScanCandidate& best = result_.best;
  if (options_.joint.model != JointModel::kAuto || best.refined.model != JointModel::kSharedStations)
    return false;
  const std::vector<ModelTest>& tests = best.refined.model_tests;
  if (std::any_of(tests.begin(), tests.end(), [](const ModelTest& test) {
        return test.general == JointModel::kFreeObject && test.score <= kScoreWorthFitting;
      }))
    return false;
  JointPriors priors = best.refined.priors;
  // Of pure turns.
  priors.station_turns.clear();
  priors.rims.clear();
  AlignedScene aligned = best.aligned;
  JointReport joint = best.refined.joint;
  PhotoAdjustment wobbling =
      AdjustByPhotos(read_photo, features_, best.refined.held_back, priors, options_.joint,
                     {JointModel::kWobblingTable, JointModel::kSharedStations, kWobbleDeviations},
                     options_.photos, reporter_, &aligned, &joint);
  result_.durations.emplace_back("wobble", watch_.Lap());
  const bool is_taken = wobbling.reason == PhotoReason::kHeldBackPatches;
  reporter_.Info(
      std::string(is_taken ? "the table wobbles: " : "the table does not wobble, as far as patches tell: ") +
      wobbling.finding);
  if (!is_taken) return false;
  best.aligned = std::move(aligned);
  best.refined.joint = std::move(joint);
  best.refined.priors = std::move(priors);
  best.refined.model = JointModel::kWobblingTable;
  result_.photos = std::move(wobbling);
  result_.findings += "; patches told how the table wobbles";
  return true;
}

// Where matches of highlights leave a station's turn open, silhouettes may tell it, and patches that it
// shares with others.
void PoseFinish::AskAllMatches() {
  ScanCandidate& best = result_.best;
  std::map<int, double> told_deg = told_turns_deg_;
  for (const auto& [station, sigma_deg] :
       TurnsByPatches(best.aligned.scene, best.refined.joint, result_.photos.tied_stations)) {
    double& told = told_deg.try_emplace(station, sigma_deg).first->second;
    told = std::max(told, sigma_deg);
  }
  best.matches =
      AskMatches(features_, likelihood_.pairs(), best.aligned, told_deg, reporter_, &best.refined.joint);
  result_.durations.emplace_back("ask_matches", watch_.Lap());
}

// Where matches leave a station's turn open, silhouettes may tell it: everything is adjusted anew about what
// they say. False where there is nothing to gain. \param from  poses before they were adjusted to photos.
bool PoseFinish::TurnBySilhouettes(const ReadGreyPhoto& read_photo, const ScanCandidate& from) {
  if (from.refined.model != JointModel::kSharedStations) return false;
  std::set<int> untold;
  for (const auto& [station, sigma_deg] : result_.best.matches.turn_sigma_deg) {
    if (std::isinf(sigma_deg)) untold.insert(station);
  }
  if (untold.empty()) return false;
  SilhouetteTies ties = TieBySilhouettes(read_photo, features_, from.aligned, untold, reporter_);
  result_.durations.emplace_back("silhouettes", watch_.Lap());
  if (ties.priors.empty()) return false;
  const double sigma_px = LikelihoodOfMatches(features_, from.aligned, likelihood_.pairs()).sigma_px;
  ScanCandidate refined = circles_.Refine(ties.aligned, sigma_px, true, {ties.priors, rims_});
  result_.durations.emplace_back("silhouettes", watch_.Lap());
  if (!refined.is_usable || refined.aligned.scene.views.size() < from.aligned.scene.views.size())
    return false;
  told_turns_deg_ = std::move(ties.sigma_deg);
  refined.finding = from.finding;
  result_.best = std::move(refined);
  result_.findings += "; silhouettes turned stations that matches had left open";
  return true;
}

// Whether poses about rims lose no photos, and no more of what matches say than the true poses would: a
// circle along edges may be another thing's, or made of the table's two rims, and whatever odds chance gives
// edges, a true rim is where the matches' poses are, but for what these gained by being fitted. Errors of
// matches that slide together count as if they were many, by as much as the adjustment says that they do.
bool PoseFinish::MatchesBear(const std::vector<RimPrior>& rims, const ScanCandidate& about_rims) const {
  const ScanCandidate& before = result_.best;
  if (!about_rims.is_usable || about_rims.aligned.scene.views.size() < before.aligned.scene.views.size())
    return false;
  const double lost = before.log_likelihood + before.charge - about_rims.log_likelihood - about_rims.charge;
  const double as_one = std::max(1.0, before.refined.priors.data_inflation);
  const double by_fitting = GainByFitting(kToldByRim * static_cast<double>(rims.size()));
  reporter_.Debug("about the table's rim the log-likelihood of the matches is " + std::to_string(lost) +
                  " less, which counts " + std::to_string(as_one) + " times, of which " +
                  std::to_string(by_fitting) + " may come of fitting; focal length " +
                  std::to_string(FocalLengths(about_rims.aligned.scene.cameras.front()).x()));
  return lost <= as_one * by_fitting;
}

// Poses about rims: the likeliest of those that an adjustment comes to from where rims put the cameras; not
// usable where matches bear none. Most circles are refused, and a first look says so; what passes is adjusted
// as poses without rims were.
ScanCandidate PoseFinish::AdjustAboutRims(const std::vector<RimPrior>& rims) const {
  const ScanCandidate& before = result_.best;
  std::vector<AlignedScene> scenes = circle_scenes_;
  scenes.push_back(before.aligned);
  ScanCandidate look;
  RimStart from;
  for (const RimStart& start :
       StartsByRims(features_, likelihood_.pairs_inside(), rims, scenes, kMostRimStarts, reporter_)) {
    ScanCandidate candidate = circles_.RefineAs(before, start.aligned, start.sigma_px, {{}, rims});
    if (!MatchesBear(rims, candidate) || !candidate.IsBetterThan(look)) continue;
    look = std::move(candidate);
    from = start;
  }
  if (!look.is_usable) return look;
  ScanCandidate refined = circles_.Refine(from.aligned, from.sigma_px, before.has_given_steps, {{}, rims});
  if (!MatchesBear(rims, refined)) return look;
  return refined.IsBetterThan(look) ? refined : look;
}

// Where matches do not tell the axis or the angles well, the table's rim may tell the axis; where not all of
// a table's rims go with the matches, the surest may.
void PoseFinish::LeanByRims(const ReadGreyPhoto& read_photo) {
  if (result_.best.refined.model != JointModel::kSharedStations || IsSure(result_.best.refined.joint)) return;
  likelihood_.Judge(&result_.best);
  std::vector<RimPrior> rims = FindRims(read_photo, features_, result_.best.aligned, reporter_);
  ScanCandidate refined;
  if (!rims.empty()) refined = AdjustAboutRims(rims);
  if (!refined.is_usable && rims.size() > 1) {
    rims.resize(1);
    refined = AdjustAboutRims(rims);
  }
  result_.durations.emplace_back("rims", watch_.Lap());
  if (!refined.is_usable) return;
  refined.finding = result_.best.finding;
  result_.best = std::move(refined);
  rims_ = std::move(rims);
  result_.findings += "; the table's rim told its axis";
}

void PoseFinish::Finish(const ReadGreyPhoto& read_photo) {
  ScanCandidate before;
  if (read_photo) {
    LeanByRims(read_photo);
    if (result_.best.aligned.scene.num_stations > 1) before = result_.best;
    AdjustToPhotos(read_photo);
  }
  AskAllMatches();
  if (!before.is_usable || !TurnBySilhouettes(read_photo, before)) return;
  AdjustToPhotos(read_photo);
  AskAllMatches();
}

void PoseFinish::FinishWithoutSilhouettes(const ReadGreyPhoto& read_photo) {
  if (read_photo) AdjustToPhotos(read_photo);
  AskAllMatches();
}

}  // namespace s2gs
