#pragma once

#include "sfm_split/evidence/verdict.h"
#include "sfm_split/scene/scan_features.h"
#include "sfm_split/turntable/align_scene.h"

namespace s2gs {

/// Records `background_across` and `background_noise_px`: the background's verified matches between placed
/// photos of different camera places, against the poses of the cameras. Of camera places that no background
/// ties none count: how far they stand apart about the axis is anybody's choice (SetsOfTiedStations).
/// \param bound_px  distance from its epipolar line at which a match agrees.
void RecordBackgroundMatches(const ScanFeatures& features, const AlignedScene& aligned, double bound_px,
                             ScanEvidence* evidence);

}  // namespace s2gs
