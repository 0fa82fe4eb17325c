#include "sfm_split/evidence/verdict.h"

#include <algorithm>
#include <cmath>

#include "sfm_split/base/format_text.h"

namespace s2gs {
namespace {

// What is asked of a scan: every pose to a degree, but for one scan in 400, the median one to .3 degrees, but
// for one in 20, and a place for each photo.
constexpr double kMaxAngleDeg = 1;
constexpr double kSigmas = 3;
constexpr double kMedianAngleDeg = 0.3;
constexpr double kMedianSigmas = 2;
constexpr double kMaxFocal = 0.01;  // of the focal length: depths are off by as much; said alone, not judged.
// Single photos and pairs may fail where nine in ten do not.
constexpr double kMost = 0.9;
constexpr size_t kMaxNamed = 5;
// The more common of two answers: of photos, of matches, of pairs.
constexpr double kHalf = 0.5;
// Cameras of photogrammetry, from fisheye to long telephoto.
constexpr double kLeastFocalWidths = 0.3;
constexpr double kMostFocalWidths = 10;
// Points around the axis have their mean near it; those of a distant body, all of its distance away.
constexpr double kAround = 0.9;
// Fewer matches than COLMAP asks of a motion between two photos tell nothing.
constexpr int64_t kLeastMatches = 15;
// Errors are measured within the bound at which a match agrees. Within two standard deviations lie 19 of 20
// right ones; with fewer, the bound and not the noise would tell how large errors are.
constexpr double kErrorSigmas = 2;
// Excess of the held-back noise over the adjusted one, in its standard deviations: three are one in 700.
constexpr double kNoiseSigmas = 3;
// Standard deviation of what half of so many normal errors stay within, times the root of how many, over it.
constexpr double kErrorOfHalf = 1.17;
// Noise that the adjustment cannot have seen grows with the parameters a match pays for; doubled, the poses
// follow the noise of the matches that they were fitted to.
constexpr double kMaxNoiseGrowth = 2;
// A prior that gives most of what is known of the focal length is not checked by the photos.
constexpr double kMaxPriorShare = 0.5;

// Of the mean of the directions in which photos look: as from all around at 60 degrees above, and as from an
// arc of some 110. A judgement: who photographs a body that does not turn goes around it.
constexpr double kMostAlike = 0.866;

int Percent(double share) { return static_cast<int>(std::lround(100 * share)); }

class Judge {
 public:
  explicit Judge(const ScanEvidence& evidence) : evidence_(evidence) {}

  ScanVerdict Run() {
    JudgePlaced();
    if (!evidence_.is_one_body) {
      JudgeSteps();
      JudgeAxis();
      JudgeSeam();
      JudgePairs();
      JudgeHeldBack();
      JudgeBackground();
      JudgeSigmas();
    }
    JudgeCameras();
    std::stable_sort(found_.begin(), found_.end(),
                     [](const Finding& a, const Finding& b) { return a.verdict > b.verdict; });
    ScanVerdict result;
    for (const Finding& finding : found_) {
      result.verdict = std::max(result.verdict, finding.verdict);
      result.poses_hold &= !finding.is_of_poses;
      result.reasons.push_back(finding.reason);
      for (const std::string& advice : finding.advice) {
        if (std::find(result.advice.begin(), result.advice.end(), advice) == result.advice.end()) {
          result.advice.push_back(advice);
        }
      }
    }
    if (result.reasons.empty()) result.reasons = Good();
    if (evidence_.is_one_body) result.reasons.emplace_back("of one body no angles of a table are told");
    if (evidence_.wrong_exif_focal) {
      result.reasons.push_back(FormatText(
          "EXIF states %.2g times the focal length that the photos show, as of photos that were cut "
          "or zoomed into, and was not followed",
          *evidence_.wrong_exif_focal));
    }
    if (evidence_.angle_prior_share && *evidence_.angle_prior_share > kMaxPriorShare) {
      result.reasons.emplace_back(
          "most of what is known of the table angles is that the table's steps are equal");
    }
    return result;
  }

 private:
  struct Finding {
    Verdict verdict;
    std::string reason;
    std::vector<std::string> advice;
    bool is_of_poses = true;  // not only of photos without one
  };

  // Advice.
  static constexpr const char* kSmallerSteps =
      "smaller steps, so that the same details show in photos next to each other";
  static constexpr const char* kTexture =
      "texture that turns with the object: a printed or speckled sheet on the table";
  static constexpr const char* kFixedCamera =
      "a camera that stands firm, with fixed exposure, white balance and focus";
  static constexpr const char* kLight =
      "soft, even light, so that highlights and shadows do not look like texture";
  static constexpr const char* kFocal =
      "a known focal length: photos with their EXIF data, or the camera's parameters by --camera_params";
  static constexpr const char* kWhole =
      "the photos as the camera took them: these look cut from larger ones, beside their middle";
  static constexpr const char* kBetween =
      "another turn from a place between the camera places, so that neighbouring ones see the same details";
  static constexpr const char* kHigher =
      "a camera that looks down at the table: before one that is level with it points go back and forth on a "
      "line, which hardly tells the lens from how far the table turned";
  static constexpr const char* kFullTurn = "a full turn whose last photo comes one step before the first";

  void Add(Verdict verdict, std::string reason, std::vector<std::string> advice) {
    found_.push_back({verdict, std::move(reason), std::move(advice), true});
  }

  void JudgePlaced() {
    const double share = evidence_.photos > 0 ? evidence_.placed / static_cast<double>(evidence_.photos) : 0;
    if (evidence_.is_one_body && evidence_.unmoved_photos > kHalf * evidence_.photos) {
      Add(Verdict::kFailed,
          FormatText("nothing was found to turn, though the camera stood still for %d of %d photos",
                     evidence_.unmoved_photos, evidence_.photos),
          {kTexture, kLight});
    }
    // What turns in the hand's photos may be too plain to be seen turning; what stands around it is one body
    // then.
    if (evidence_.is_one_body && evidence_.looks_alike && *evidence_.looks_alike > kMostAlike) {
      Add(Verdict::kDoubtful,
          "nothing was found to turn, though all photos look from one side, so that they may show the "
          "surroundings alone",
          {kFixedCamera, kTexture});
    }
    if (evidence_.placed < evidence_.photos) {
      std::string said = FormatText("%d of %d photos have a place", evidence_.placed, evidence_.photos);
      const size_t named = std::min(evidence_.missing.size(), kMaxNamed);
      for (size_t k = 0; k < named; ++k) said += (k == 0 ? ", without: " : ", ") + evidence_.missing[k];
      if (named < evidence_.missing.size())
        said += FormatText(" and %d more", static_cast<int>(evidence_.missing.size() - named));
      Add(share < kHalf ? Verdict::kFailed : Verdict::kDoubtful, std::move(said), {kSmallerSteps, kTexture});
      found_.back().is_of_poses = share < kMost;
    }
    const auto unsupported = static_cast<double>(evidence_.unsupported.size());
    if (unsupported > (1 - kMost) * evidence_.placed) {
      Add(Verdict::kDoubtful,
          FormatText("the matches of %d photos bear out their places no better than chance might",
                     static_cast<int>(evidence_.unsupported.size())),
          {kTexture, kSmallerSteps});
    }
  }

  // Points of a body that turns by an angle move no farther than the angle times what it sweeps.
  void JudgeSteps() {
    if (!evidence_.median_step_deg || !evidence_.least_step_deg) return;
    const double step = std::abs(*evidence_.median_step_deg);
    if (step >= *evidence_.least_step_deg) return;
    Add(Verdict::kFailed,
        FormatText(
            "photos that share details are said to be %.2g degrees of the table apart, but the details move "
            "as "
            "far as %.2g or more ask",
            step, *evidence_.least_step_deg),
        {kFocal, kTexture});
  }

  // An axis between the camera and the object, or through the camera, makes a turn what is none: details move
  // by it as they do when the camera swings. Only a camera above the table may be nearer to the axis than
  // what turns.
  void JudgeAxis() {
    if (!evidence_.camera_radius_rel || !evidence_.points_one_side || !evidence_.camera_height_rel) return;
    if (*evidence_.camera_radius_rel >= 1 || *evidence_.camera_height_rel >= 1) return;
    if (*evidence_.points_one_side < kAround) return;
    Add(Verdict::kFailed, "the table's axis came out nearer to the camera than to what turns",
        {kTexture, kFocal});
  }

  void JudgeSeam() {
    if (evidence_.turns_of_nothing > 0) {
      Add(Verdict::kDoubtful,
          "the last photos and the first share details, but by the poses the table went and came back the "
          "same way",
          {kTexture, kSmallerSteps, kFocal});
    }
    // Photos farther apart share fewer details: as many as neighbours have, and none that bear out the poses,
    // they cannot be several times as far.
    if (evidence_.far_pairs > 0 && evidence_.widest_far_pair_deg && evidence_.neighbour_apart_deg) {
      Add(Verdict::kDoubtful,
          FormatText(
              "%d pairs of photos share as many details as neighbours, but are up to %.3g degrees apart by "
              "the poses, "
              "neighbours %.3g",
              evidence_.far_pairs, *evidence_.widest_far_pair_deg, *evidence_.neighbour_apart_deg),
          {kFocal, kTexture, kSmallerSteps});
    }
    const std::optional<double> seam = evidence_.seam.Share();
    if (!seam || evidence_.seam.all < kLeastMatches) return;
    const double others = evidence_.neighbours.Share().value_or(1);
    if (*seam >= kHalf * others) return;
    Add(Verdict::kFailed,
        FormatText(
            "the turn does not close: of %d matches between its last photos and its first, %d %% agree with "
            "the "
            "poses, of those between neighbours %d %%",
            static_cast<int>(evidence_.seam.all), Percent(std::max(0.0, *seam)), Percent(others)),
        {kTexture, kSmallerSteps, kFullTurn});
  }

  // By matches across the end of the turn, at each station. Of stations with one lens one such will do, where
  // the others go round by the poses: how far neighbours are apart is a matter of the lens, which it tells.
  bool Closes() const {
    const auto bears_out = [](const AgreeingMatches& matches) {
      return matches.all >= kLeastMatches && matches.Share().value_or(0) >= kMost;
    };
    const bool is_told_by_one = evidence_.closed_stations > 0 && evidence_.focal_widths.size() == 1 &&
                                evidence_.round_stations >= evidence_.stations;
    return (is_told_by_one || evidence_.closed_stations >= evidence_.stations) &&
           evidence_.turns_of_nothing == 0 && evidence_.contradicted_seams == 0 &&
           bears_out(evidence_.closing) && bears_out(evidence_.neighbours);
  }

  void JudgePairs() {
    const std::optional<double> share = evidence_.neighbours.Share();
    const bool said = share && evidence_.neighbours.all >= kLeastMatches && *share < kHalf;
    if (said) {
      Add(Verdict::kFailed,
          FormatText(
              "of %lld matches that photos next to each other prove by themselves, %d %% agree with the "
              "poses",
              static_cast<long long>(evidence_.neighbours.all), Percent(std::max(0.0, *share))),
          {kTexture, kSmallerSteps, kFixedCamera});
    }
    if (!said && evidence_.contradicted_neighbours > (1 - kMost) * evidence_.neighbour_pairs) {
      Add(Verdict::kDoubtful,
          FormatText("%d of %d pairs of photos next to each other contradict the poses",
                     evidence_.contradicted_neighbours, evidence_.neighbour_pairs),
          {kSmallerSteps, kFixedCamera});
    }
    if (!evidence_.misturned.empty()) {
      Add(Verdict::kDoubtful,
          FormatText(
              "%d photos are up to %.3g degrees of the table from where their matches put them, like %s",
              static_cast<int>(evidence_.misturned.size()), evidence_.worst_misturn_deg,
              evidence_.misturned[0].c_str()),
          {kSmallerSteps, kTexture});
    }
    if (static_cast<double>(evidence_.untold.size()) > (1 - kMost) * evidence_.placed) {
      Add(Verdict::kDoubtful,
          FormatText("the matches of %d photos, like %s, do not tell their places in the turn",
                     static_cast<int>(evidence_.untold.size()), evidence_.untold[0].c_str()),
          {kTexture, kSmallerSteps});
    }
    if (!evidence_.untold_stations.empty()) {
      Add(Verdict::kDoubtful,
          FormatText(
              "the matches at a camera place do not tell whether the table turned as the poses say, like "
              "that of %s",
              evidence_.untold_stations[0].c_str()),
          {kTexture});
    }
    if (evidence_.neighbour_pairs == 0 && evidence_.verified.all < kLeastMatches) {
      Add(Verdict::kDoubtful, "no pair of photos proves by itself how the object turns",
          {kTexture, kSmallerSteps});
    }
  }

  // Of matches' errors [px].
  bool IsNoisy(double noise_px) const { return kErrorSigmas * noise_px > evidence_.bound_px; }

  void JudgeHeldBack() {
    const std::optional<double> share = evidence_.held_back.Share();
    const bool is_low = share && evidence_.held_back.all >= kLeastMatches && *share < kHalf;
    // Photos far apart of a glossy body that looks alike from all around prove much that is wrong. A turn
    // that its neighbours bear out and that closes by its own matches needs no other proof, as long as what
    // was held back agrees with it as what was adjusted does.
    const bool is_like_the_others =
        share && *share >= kHalf * evidence_.adjusted.Share().value_or(1) && Closes();
    if (is_low && !is_like_the_others) {
      Add(Verdict::kFailed,
          FormatText("of %d details that were held back, %d %% agree with the poses",
                     static_cast<int>(evidence_.held_back.all), Percent(std::max(0.0, *share))),
          {kTexture, kSmallerSteps});
    }
    // Of verified matches, and of right ones among all: what is wrong alike makes either too large.
    std::optional<double> noise = evidence_.adjusted_noise_px;
    if (noise && evidence_.match_noise_px) noise = std::min(*noise, *evidence_.match_noise_px);
    if (noise && IsNoisy(*noise)) {
      Add(Verdict::kDoubtful,
          FormatText(
              "matches miss their lines by %.2g px, more than the %.2g px of keypoints that the poses are "
              "for",
              *noise, evidence_.bound_px / kErrorSigmas),
          {kTexture, kLight, kFixedCamera});
    }
    if (!evidence_.adjusted_noise_px || !evidence_.held_back_noise_px) return;
    const double adjusted = *evidence_.adjusted_noise_px;
    const double held_back = *evidence_.held_back_noise_px;
    const double sigma = kErrorOfHalf * adjusted /
                         std::sqrt(static_cast<double>(std::max<int64_t>(1, evidence_.held_back.all)));
    if (held_back > kMaxNoiseGrowth * adjusted && held_back > adjusted + kNoiseSigmas * sigma) {
      Add(Verdict::kDoubtful,
          FormatText(
              "details that were held back miss their lines by %.2f px, those that were adjusted by %.2f px",
              held_back, adjusted),
          {kTexture, kSmallerSteps});
    }
  }

  // What stands still and is seen from two camera places tells how the table turned between them, as the
  // object does; where it was found to be as noisy as the object may be, one of the two is wrong.
  void JudgeBackground() {
    if (evidence_.background_across.all < kLeastMatches || !evidence_.background_noise_px) return;
    const double share = evidence_.background_across.Share().value_or(1);
    if (!IsNoisy(*evidence_.background_noise_px) && share >= kHalf) return;
    Add(Verdict::kDoubtful,
        FormatText(
            "of %lld matches of what stands still between camera places, %d %% agree with the cameras, "
            "which they miss by %.2g px",
            static_cast<long long>(evidence_.background_across.all), Percent(std::max(0.0, share)),
            *evidence_.background_noise_px),
        {kBetween, kFixedCamera, kFocal});
  }

  // Cameras that stand no higher over the points than these lie from the axis.
  bool IsLevel() const { return evidence_.camera_height_rel && *evidence_.camera_height_rel < 1; }

  void JudgeSigmas() {
    if (evidence_.are_sigmas_missing) {
      Add(Verdict::kDoubtful,
          "how surely the photos tell the poses was not computed, as each photo has a pose of its own and "
          "there "
          "are too many",
          {kFixedCamera});
    }
    if (evidence_.angle_sigma_max_deg && kSigmas * *evidence_.angle_sigma_max_deg > kMaxAngleDeg) {
      Add(Verdict::kDoubtful,
          std::isfinite(*evidence_.angle_sigma_max_deg)
              ? FormatText("a table angle is known to +- %.2g degrees only", *evidence_.angle_sigma_max_deg)
              : std::string("a table angle cannot be told from the photos"),
          evidence_.stations > 1 ? std::vector<std::string>{kBetween, kTexture, kSmallerSteps}
          : IsLevel()            ? std::vector<std::string>{kHigher, kFullTurn, kTexture}
                                 : std::vector<std::string>{kTexture, kSmallerSteps, kFullTurn});
    }
    if (evidence_.angle_sigma_median_deg && std::isfinite(*evidence_.angle_sigma_median_deg) &&
        kMedianSigmas * *evidence_.angle_sigma_median_deg > kMedianAngleDeg) {
      Add(Verdict::kDoubtful,
          FormatText("table angles are known to +- %.2g degrees only", *evidence_.angle_sigma_median_deg),
          {kTexture, kSmallerSteps});
    }
    // Where the axis is wrong before the camera, the rotation of each photo of the station is, by as much,
    // and so the median one.
    if (evidence_.axis_sigma_deg && kMedianSigmas * *evidence_.axis_sigma_deg > kMedianAngleDeg) {
      Add(Verdict::kDoubtful,
          std::isfinite(*evidence_.axis_sigma_deg)
              ? FormatText("the direction of the table's axis is known to +- %.2g degrees only",
                           *evidence_.axis_sigma_deg)
              : std::string("the direction of the table's axis cannot be told from the photos"),
          evidence_.are_photos_cut ? std::vector<std::string>{kWhole, kBetween}
                                   : std::vector<std::string>{kTexture, kLight, kFocal});
    }
  }

  void JudgeCameras() {
    for (const double widths : evidence_.focal_widths) {
      if (widths >= kLeastFocalWidths && widths <= kMostFocalWidths) continue;
      Add(Verdict::kFailed, FormatText("the focal length came out as %.2g times the photos' width", widths),
          {kFocal});
    }
    if (evidence_.is_focal_guessed) {
      Add(Verdict::kDoubtful, "the focal length is a guess that the photos do not check", {kFocal, kTexture});
    }
    if (evidence_.focal_prior_share && *evidence_.focal_prior_share > kMaxPriorShare &&
        evidence_.focal_sigma_rel && evidence_.angle_sigma_max_deg &&
        kSigmas * *evidence_.angle_sigma_max_deg > kMaxAngleDeg) {
      Add(Verdict::kDoubtful, "most of what is known of the focal length is a guess", {kFocal});
    }
  }

  std::vector<std::string> Good() const {
    std::vector<std::string> reasons;
    reasons.push_back(FormatText("%d of %d photos have a place", evidence_.placed, evidence_.photos));
    const auto add = [&](const AgreeingMatches& matches, const char* of) {
      if (const std::optional<double> share = matches.Share()) {
        reasons.push_back(FormatText("%d %% of %lld %s agree with the poses", Percent(*share),
                                     static_cast<long long>(matches.all), of));
      }
    };
    add(evidence_.held_back, "details that were held back");
    if (evidence_.closing.agreeing > 0) {
      reasons.push_back(FormatText("%lld matches across the end of the turn bear out the poses",
                                   static_cast<long long>(evidence_.closing.agreeing)));
    }
    add(evidence_.across_stations, "matches between camera places");
    // Poses hold all the same: what a focal length does to them, the object's depth makes up for.
    if (kSigmas * evidence_.focal_sigma_rel.value_or(0) > kMaxFocal) {
      reasons.push_back(
          std::isfinite(*evidence_.focal_sigma_rel)
              ? FormatText("the focal length is known to +- %.2g %%, and how deep things are no better",
                           100 * *evidence_.focal_sigma_rel)
              : std::string("the focal length, and how deep things are, cannot be told from the photos"));
    }
    return reasons;
  }

  const ScanEvidence& evidence_;
  std::vector<Finding> found_;
};

}  // namespace

const char* VerdictName(Verdict verdict) {
  switch (verdict) {
    case Verdict::kGood:
      return "good";
    case Verdict::kDoubtful:
      return "doubtful";
    case Verdict::kFailed:
      return "failed";
  }
  return "";
}

std::optional<double> AgreeingMatches::Share() const {
  if (all <= 0 || by_chance >= static_cast<double>(all)) return std::nullopt;
  return (static_cast<double>(agreeing) - by_chance) / (static_cast<double>(all) - by_chance);
}

void AgreeingMatches::Add(const AgreeingMatches& other) {
  all += other.all;
  agreeing += other.agreeing;
  by_chance += other.by_chance;
}

ScanVerdict JudgeScan(const ScanEvidence& evidence) { return Judge(evidence).Run(); }

}  // namespace s2gs
