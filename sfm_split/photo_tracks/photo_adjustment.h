#pragma once

#include <functional>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "sfm_split/adjust/joint_ba.h"
#include "sfm_split/base/reporter.h"
#include "sfm_split/evidence/held_back.h"
#include "sfm_split/joint_system/joint_priors.h"
#include "sfm_split/photo_tracks/track_places.h"
#include "sfm_split/scene/scan_features.h"
#include "sfm_split/turntable/align_scene.h"

namespace s2gs {

/// Errors of points that the poses were not adjusted to, by poses before and after.
struct HeldBackChange {
  int points = 0;
  double before_px = 0;  ///< median distance of a place from its point.
  double after_px = 0;
  /// What a point's loss (the adjustment's) fell by, in the mean, and the standard deviation of this mean.
  double gain = 0;
  double gain_sigma = 0;
  /// How many times larger errors are than places say of themselves, 1 at least. What is more than noise
  /// (shading that stays in the world, a lens or a sheet that bends otherwise) is alike at neighbours, so
  /// that points are no longer witnesses of their own.
  double overdispersion = 1;

  static constexpr double kCertain = 3.4;  ///< standard deviations: chance goes beyond once in e^8.
  bool HasFallen(double deviations = kCertain) const {
    return points > 1 && gain > deviations * overdispersion * gain_sigma;
  }
  bool HasRisen() const { return points > 1 && -gain > kCertain * overdispersion * gain_sigma; }
};

/// How much likelier the distances of a station's places from where another station's put their points [px]
/// are as errors than as places that lie anywhere within `reach_px`: the logarithm, at least half of them
/// being right.
double LogRatioOfLinks(const std::vector<double>& errors, double reach_px);

/// For which of two reasons poses by patches are taken.
enum class PhotoReason {
  kNone,                ///< they are not.
  kHeldBackPatches,     ///< errors of patches that were held back fell.
  kStandardDeviations,  ///< ... did not rise, and the adjustment states smaller standard deviations.
};

/// Where the points of tracks were looked for.
enum class PhotosLookedIn {
  kFacing,  ///< in all photos that they face.
  kTracks,  ///< in photos whose keypoints see them.
};

struct PhotoAdjustment {
  bool is_taken = false;
  PhotoReason reason = PhotoReason::kNone;
  PhotosLookedIn looked_in = PhotosLookedIn::kFacing;  ///< of the last try, which the rest is about.
  std::string finding;                                 ///< why (not), for the report.
  /// Why it is not about all photos that points face; empty where it is.
  std::string facing_finding;
  int tracks = 0;  ///< whose patches agree.
  int places = 0;
  int places_beside = 0;     ///< of these, in photos whose keypoints do not see the point.
  double sigma_px = 0;       ///< of a place, as its patch says (median).
  HeldBackChange patches;    ///< of each half's places by poses of the other half.
  HeldBackChange keypoints;  ///< of points that no adjustment saw.
  /// Per camera, the focal length [px] that patches ask for which bear each other out and are refused because
  /// their errors are more than noise; empty where there are none.
  std::vector<double> refused_focal_px;
  /// Stations that patches seen from them and from the reference's, or from others in between, tie to it,
  /// where poses are taken: what one station's patches say of the other's is right by more than chance
  /// explains.
  std::set<int> tied_stations;
  /// Mean change of the logarithms of the stated standard deviations: focal length, axis, table angles. 0
  /// where it did not come to an adjustment by all patches, infinite where there is none to compare.
  double log_sigma_change = 0;
  double seconds = 0;
};

struct PhotoAdjustmentOptions {
  TrackPlacesOptions places;
  double max_error_px = 4;             ///< from its point, of a keypoint that stays with it.
  int max_adjusted_background = 1200;  ///< points.

  OptionCheck Check() const;
};

/// What poses are to share.
struct PosesToAdjust {
  JointModel model = JointModel::kAuto;
  /// A simpler one, which the same patches are given to as well: patches that were held back compare these
  /// two. Without it they compare the model with the scene's own poses, which may have seen all of them.
  std::optional<JointModel> rival;
  double deviations =
      HeldBackChange::kCertain;  ///< of the errors' fall, which tell it from chance (HeldBackChange).
};

/// Where photos show points of the object, by its poses as they stand. Ids of points that are none of the
/// model's follow those of the model's.
using FindTracks = std::function<std::vector<AlignedTrack>(PhotosLookedIn where)>;

/// Poses by patches of the photos: everything is adjusted again, with patches' places in the stead of the
/// object's keypoints, which stay in photos with too few places. The poses are taken where they bear patches
/// out that they were not adjusted to (of either half of the points by the other half) better than the
/// scene's own, or no worse while the adjustment states smaller standard deviations; where these patches'
/// errors are mostly noise; and where keypoints that no adjustment saw lie no farther off than patches' own
/// errors explain (they carry the bias that patches remove). A focal length that standard deviations before
/// do not allow is taken on the former ground alone. Where they are not taken, the same is tried with the
/// photos of the tracks alone, beside all other keypoints by their own noise; the scene is untouched where
/// neither is. Where poses are taken, both models' points are adjusted to them all, and the object's
/// keypoints in `aligned->object` are where patches were found.
/// \param priors  of the adjustment that the scene comes from.
/// \param poses   what they share.
/// \param joint   the adjustment that the scene comes from; replaced where poses are taken.
PhotoAdjustment AdjustByTracks(const FindTracks& find, const ScanFeatures& features,
                               const HeldBackKeypoints& held_back, const JointPriors& priors,
                               const JointOptions& joint_options, const PosesToAdjust& poses,
                               const PhotoAdjustmentOptions& options, Reporter& reporter,
                               AlignedScene* aligned, JointReport* joint);

/// The same with the object's points, which are looked for in all photos that they face (AlignTracks).
PhotoAdjustment AdjustByPhotos(const ReadGreyPhoto& read, const ScanFeatures& features,
                               const HeldBackKeypoints& held_back, const JointPriors& priors,
                               const JointOptions& joint_options, const PosesToAdjust& poses,
                               const PhotoAdjustmentOptions& options, Reporter& reporter,
                               AlignedScene* aligned, JointReport* joint);

}  // namespace s2gs
