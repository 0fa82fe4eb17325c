#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace s2gs {

/// What may be expected of a scan's poses.
enum class Verdict {
  kGood,      ///< what was held back bears them out.
  kDoubtful,  ///< something contradicts them, or too little bears them out.
  kFailed,    ///< they are wrong, or most photos have none.
};
/// "good", "doubtful", "failed".
const char* VerdictName(Verdict verdict);

/// Matches, or details, of which some agree with the poses.
struct AgreeingMatches {
  int64_t all = 0;
  int64_t agreeing = 0;
  /// As many as would agree if each keypoint were matched with that of another match of the pair.
  double by_chance = 0;

  /// The share of the right ones that agree when chance lets the rest agree as often as it does: 1 when all
  /// do, 0 when no more than by chance do; nothing when there are none, or when chance explains them all.
  std::optional<double> Share() const;
  void Add(const AgreeingMatches& other);
};

/// What is known of a scan's poses beside the poses. What was not measured has no value.
struct ScanEvidence {
  int photos = 0;
  int placed = 0;
  int stations = 0;                  ///< of placed photos.
  std::vector<std::string> missing;  ///< names of the others, as far as they are known.
  /// Photos whose matches agree with their places no better than they might by chance.
  std::vector<std::string> unsupported;

  /// All photos were taken for one rigid body.
  bool is_one_body = false;
  int unmoved_photos = 0;  ///< those of camera places that have at least three.

  double bound_px = 0;       ///< distance from its epipolar line at which a match agrees.
  AgreeingMatches verified;  ///< of the object, between placed photos.
  /// Details, each of which errs by itself: sets of keypoints that these tie together (SetsOfKeypoints), by
  /// the share of their matches that agree. Those that no adjustment has seen, a tenth ...
  AgreeingMatches held_back;
  AgreeingMatches adjusted;                 ///< ... and the others.
  std::optional<double> adjusted_noise_px;  ///< standard deviation of the latters' matches' errors ...
  std::optional<double>
      held_back_noise_px;  ///< ... and of those held back, as half of the right details tell it.
  std::optional<double> match_noise_px;  ///< of right ones among all matches, verified or not.
  double overdispersion = 1;             ///< by how much logarithms of likelihoods are too large.

  AgreeingMatches across_stations;  ///< those verified matches whose photos are of different stations.
  /// The background's verified matches between photos of different stations that it ties.
  AgreeingMatches background_across;
  std::optional<double> background_noise_px;  ///< standard deviation of these matches' errors.
  /// What pairs of photos of one station prove by themselves: matches that move and follow one epipolar
  /// geometry, the poses' or their own, more of them than chance explains (ProvePair), whether or not the
  /// split kept them. Of photos next to each other, and of a station's last photos with its first, but for
  /// those far apart by the poses that share fewer details than far_pairs do.
  AgreeingMatches neighbours;
  AgreeingMatches seam;
  /// Those of the last whose photos are neighbours across the end of a turn that goes round by the poses: an
  /// arc's last photos may show what its first do, and say nothing of a turn that closes.
  AgreeingMatches closing;
  int closed_stations = 0;  ///< those that have such a pair that does not contradict the poses.
  int round_stations = 0;   ///< those whose photos go round by the poses, whether or not a pair says so.
  int neighbour_pairs = 0;
  int contradicted_neighbours = 0;  ///< pairs that prove another motion than the poses'.
  int seam_pairs = 0;
  int contradicted_seams = 0;
  int other_bodies = 0;  ///< pairs in which something else moves beside what the poses are of.
  /// Photos that their matches put at another angle of the table, alone or with all that follow; by how much
  /// at most.
  std::vector<std::string> misturned;
  double worst_misturn_deg = 0;
  std::vector<std::string> untold;  ///< photos whose matches would be as likely half a step away.
  /// First photos of stations at which the matches do not tell how the table turned.
  std::vector<std::string> untold_stations;
  std::optional<double> neighbour_apart_deg;  ///< table angle between the photos of such a pair (median).
  /// Pairs of both kinds that contradict the poses and share at least half as many details as neighbours do
  /// in the mean, but are more than three times as far apart by the poses; and the widest of them.
  int far_pairs = 0;
  std::optional<double> widest_far_pair_deg;
  /// Stations whose last photos and first share details and stand a few steps apart, though their steps and
  /// the one across the end add up to no turn at all: the table went and came back the same way.
  int turns_of_nothing = 0;

  /// Table angle between photos that share details, by the poses, and the least that lets them move as they
  /// do.
  std::optional<double> median_step_deg;
  std::optional<double> least_step_deg;

  /// Where the axis came out: the cameras' distance from it over that of the object's points (medians); the
  /// length of the mean of the points' directions from it, 1 when all lie on one side; the cameras' height
  /// over the points, over the same distance.
  std::optional<double> camera_radius_rel;
  std::optional<double> points_one_side;
  std::optional<double> camera_height_rel;

  std::vector<double> focal_widths;  ///< of each camera, over the photo's width.
  /// Standard deviations; the shares that rest on priors.
  std::optional<double> focal_sigma_rel;
  std::optional<double> focal_prior_share;
  /// What EXIF states of the focal length over what came out, where the photos contradict it (FocalPrior).
  std::optional<double> wrong_exif_focal;
  bool are_photos_cut = false;    ///< the adjustment found principal points beside their middle.
  bool is_focal_guessed = false;  ///< neither the photos' data nor the adjustment tells it.
  std::optional<double> angle_prior_share;
  std::optional<double> angle_sigma_median_deg;
  std::optional<double> angle_sigma_max_deg;
  std::optional<double> axis_sigma_deg;  ///< of the axis' direction before the camera, the worse one.
  std::optional<double> scale_sigma_rel;
  bool is_object_free = false;  ///< each photo has an object pose of its own.
  /// Of one body: length of the mean of the cameras' viewing directions, 1 when all look the same way.
  std::optional<double> looks_alike;
  bool are_sigmas_missing = false;  ///< asked for, but there are too many unknowns (JointOptions).
};

struct ScanVerdict {
  Verdict verdict = Verdict::kGood;
  std::vector<std::string> reasons;  ///< sentences without full stop, the gravest first; also why it is good.
  std::vector<std::string> advice;   ///< what to photograph differently; empty when good.
  /// Nothing speaks against the poses that there are: all that is wrong, if anything, is that a few photos
  /// have none. A model can be built on them.
  bool poses_hold = true;
};

/// The verdict on evidence. Bounds come from chance, from noise or from what is asked of a scan (table angles
/// to a degree); the shares of a half and of nine tenths and the factor of two for noise are judgement.
ScanVerdict JudgeScan(const ScanEvidence& evidence);

}  // namespace s2gs
