#pragma once

#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "sfm_split/adjust/joint_ba.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/reporter.h"
#include "sfm_split/circular_motion/circular_motion.h"
#include "sfm_split/circular_motion/circular_scene.h"
#include "sfm_split/evidence/verdict.h"
#include "sfm_split/photo_tracks/photo_adjustment.h"
#include "sfm_split/placement/scan_candidate.h"
#include "sfm_split/relocalise/guided_registration.h"
#include "sfm_split/relocalise/scan_refinement.h"
#include "sfm_split/scene/io/colmap_model.h"
#include "sfm_split/scene/scan_features.h"
#include "sfm_split/single_axis/single_axis.h"
#include "sfm_split/turntable/turntable.h"

namespace s2gs {

enum class PlacementPath {
  kAuto,        ///< free SfM; where that is not enough, the other ways beside it, and the best of them.
  kFreeSfm,     ///< by SfM's model of the object.
  kCircular,    ///< by each station's circular motion, from its matches alone.
  kSingleAxis,  ///< by the table's axis and angles alone, from the background's cameras.
};

struct PlacementOptions {
  PlacementPath path = PlacementPath::kAuto;
  /// Free SfM that places fewer of the photos does not stand without the other ways beside it.
  double enough_share = 0.95;
  /// Photos that are placed later leave the errors of the object's points as they were, if they are right:
  /// an adjustment whose error grows by more than this factor, of what it was or of `least_noise_px` if that
  /// is more, takes them out again.
  double max_noise_growth = 1.5;
  double least_noise_px = 0.3;

  TurntableOptions turntable;
  JointOptions joint;
  RefineOptions refine;
  CircularOptions circular;
  SingleAxisOptions single_axis;
  GuidedOptions guided;
  PhotoAdjustmentOptions photos;

  /// Of the fields above the parts; each part has a Check() of its own.
  OptionCheck Check() const;
};

enum class PlacementOutcome {
  kPlaced,          ///< `best` is an adjusted turntable scene.
  kNothingRotates,  ///< both reconstructions move as one: the photos show one rigid body.
  kNoTurntable,     ///< `findings` says what each way found instead.
};

/// Where the photos stand, which way led there, and what the others found.
struct ScanPlacement {
  PlacementOutcome outcome = PlacementOutcome::kNoTurntable;
  ScanCandidate best;                                     ///< usable when placed.
  std::string path;                                       ///< that `best` came by: "free_sfm", ...
  std::string findings;                                   ///< of every way that was tried, in order.
  std::vector<GuidedPhoto> guided;                        ///< photos that came by what points look like.
  PhotoAdjustment photos;                                 ///< what patches of the photos did to `best`.
  std::vector<std::pair<std::string, double>> durations;  ///< of every way that was tried [s].
  std::optional<ScanEvidence> evidence;  ///< of `best`, where it was gathered to decide whether it is taken.
};

/// Of a scan that circular motion has placed, what PlaceScan comes to, without SfM's model of the object: the
/// motion is where the same adjustment starts that SfM's model starts otherwise, and where it explains
/// matches better than that, it is adjusted in its own way as well. It is placed where all photos are and the
/// verdict is good; otherwise `findings` says what is missing, and PlaceScan has to be asked. Which of the
/// two is taken depends on the photos alone. \param circle   as SceneFromCircularMotion has it, and what it
/// says of it. \param background, read_photo  as PlaceScan has them. Throws Interrupted when the reporter
/// asks to stop, and what read_photo throws.
ScanPlacement PlaceByCircleAlone(const ScanFeatures& features, const AlignedScene& circle,
                                 const CircularFinding& finding, const ColmapModel* background,
                                 const ReadGreyPhoto& read_photo, const PlacementOptions& options,
                                 Reporter& reporter);

/// From the reconstructions of both bodies to one adjusted turntable scene: free SfM of the object against
/// the background; where that places too few photos, against the object's own stations; where it does, or
/// each station's circular motion explains the station's matches better than free SfM did (as where a turn
/// closes that free SfM left open), by circular motion; where there are too few photos still, by the single
/// axis. The best of them by the likelihood of all matches. Then photos that are still missing, by what the
/// object's points look like, for as long as the adjustment bears them out. At last everything is adjusted to
/// patches of the photos (AdjustByPhotos).
/// \param objects  SfM's models of the object, the largest first, smaller ones in frames of their own; not
///     needed by the single axis.
/// \param background  SfM's model of the background; null: none.
/// \param read_descriptors  is called only when photos are missing.
/// \param read_photo  may be empty: then keypoints alone place the scene.
/// Throws Interrupted when the reporter asks to stop, and what read_descriptors and read_photo throw.
ScanPlacement PlaceScan(const ScanFeatures& features, const std::vector<ColmapModel>& objects,
                        const ColmapModel* background, const ReadDescriptors& read_descriptors,
                        const ReadGreyPhoto& read_photo, const PlacementOptions& options, Reporter& reporter);

}  // namespace s2gs
