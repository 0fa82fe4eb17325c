#pragma once

#include <map>
#include <set>
#include <vector>

#include "sfm_split/base/reporter.h"
#include "sfm_split/joint_system/joint_priors.h"
#include "sfm_split/photo_tracks/track_places.h"
#include "sfm_split/scene/scan_features.h"
#include "sfm_split/turntable/align_scene.h"

namespace s2gs {

/// Stations turned as silhouettes say.
struct SilhouetteTies {
  AlignedScene aligned;                  ///< with the object turned before these stations.
  std::vector<StationTurnPrior> priors;  ///< one a station that was told, by images of the features.
  std::map<int, double> sigma_deg;       ///< by station: standard deviation of its turn.
};

/// Asks silhouettes how the object stands before stations whose matches do not tell (AskSilhouettes). Only of
/// those whose cameras the background ties to the reference's: of others a turn is not all that is open.
/// Throws Interrupted when the reporter asks to stop, and what `read` throws.
SilhouetteTies TieBySilhouettes(const ReadGreyPhoto& read, const ScanFeatures& features,
                                const AlignedScene& aligned, const std::set<int>& untold, Reporter& reporter);

}  // namespace s2gs
