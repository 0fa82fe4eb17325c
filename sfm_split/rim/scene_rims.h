#pragma once

#include <vector>

#include "sfm_split/base/reporter.h"
#include "sfm_split/joint_system/joint_priors.h"
#include "sfm_split/photo_tracks/track_places.h"
#include "sfm_split/scene/scan_features.h"
#include "sfm_split/turntable/align_scene.h"

namespace s2gs {

/// The table's rim in what each station's camera sees that stands still (FindRim), by images of the features:
/// the station's first that has a place. Stations with too few photos to tell what stands still, and those
/// that show no rim, have none. Photos that cannot be read, or have another size than their station's, are
/// left out. Throws Interrupted when the reporter asks to stop, and what `read` throws.
std::vector<RimPrior> FindRims(const ReadGreyPhoto& read, const ScanFeatures& features,
                               const AlignedScene& aligned, Reporter& reporter);

}  // namespace s2gs
