#pragma once

#include <vector>

#include "sfm_split/base/reporter.h"
#include "sfm_split/circular_motion/possible_matches.h"
#include "sfm_split/scene/scan_features.h"
#include "sfm_split/turntable/align_scene.h"

namespace s2gs {

/// Aligned scenes, without points, of all photos at stations that the background's model knows: one axis for
/// all of them and steps that close, from raw matches, right and wrong ones; the likeliest first. None where
/// the background knows fewer than two stations, or the matches tell no circle.
/// \param object_pairs  of PossibleObjectPairs(), also those between stations.
/// \param sigma_px      of a right match's epipolar error. Throws Interrupted when the reporter asks to stop.
std::vector<AlignedScene> ScenesFromRiggedCircles(const ScanFeatures& features,
                                                  const std::vector<PossiblePair>& object_pairs,
                                                  const ColmapModel& background, double sigma_px,
                                                  Reporter& reporter);

}  // namespace s2gs
