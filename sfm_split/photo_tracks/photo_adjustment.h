#pragma once

#include <optional>
#include <set>
#include <string>

#include "sfm_split/adjust/joint_ba.h"
#include "sfm_split/adjust/joint_priors.h"
#include "sfm_split/base/reporter.h"
#include "sfm_split/evidence/held_back.h"
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

  /// By more than chance does once in e^8.
  bool HasFallen() const { return points > 1 && gain > 3.4 * overdispersion * gain_sigma; }
};

struct PhotoAdjustment {
  bool is_taken = false;
  std::string finding;  ///< why (not), for the report.
  int tracks = 0;       ///< whose patches agree.
  int places = 0;
  double sigma_px = 0;       ///< of a place, as its patch says (median).
  HeldBackChange patches;    ///< of each half's places by poses of the other half.
  HeldBackChange keypoints;  ///< of points that no adjustment saw.
  double seconds = 0;
};

struct PhotoAdjustmentOptions {
  TrackPlacesOptions places;
  double max_error_px = 4;             ///< from its point, of a keypoint that stays with it.
  int max_adjusted_background = 1200;  ///< points.

  OptionCheck Check() const;
};

/// Poses by patches of the photos: the tracks of the object's points are aligned (AlignTracks), and
/// everything is adjusted again, with patches' places in the stead of keypoints where they were found.
/// Keypoints of all other points count by their own noise. The poses are taken where the patches of either
/// half of the points tell poses that the other half's lie nearer to than to the scene's own, more so than
/// chance allows, and where keypoints that no adjustment saw lie no farther off than patches' own errors
/// explain (they carry the bias that patches remove); the scene is untouched otherwise. Where they are taken,
/// both models' points are adjusted to them all, and the object's keypoints in `aligned->object` are where
/// patches were found. \param priors  of the adjustment that the scene comes from. \param model   what the
/// poses share. \param joint   the adjustment that the scene comes from; replaced where poses are taken.
PhotoAdjustment AdjustByPhotos(const ReadGreyPhoto& read, const ScanFeatures& features,
                               const HeldBackKeypoints& held_back, const JointPriors& priors,
                               const JointOptions& joint_options, JointModel model,
                               const PhotoAdjustmentOptions& options, Reporter& reporter,
                               AlignedScene* aligned, JointReport* joint);

}  // namespace s2gs
