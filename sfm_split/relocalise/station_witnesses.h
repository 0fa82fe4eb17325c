#pragma once

#include <vector>

#include "sfm_split/circular_motion/possible_matches.h"
#include "sfm_split/scene/scan_features.h"
#include "sfm_split/turntable/align_scene.h"

namespace s2gs {

/// The pairs of a scene's photos for asking how stations are turned against each other. Matches inside
/// stations stay as they are. Between stations all matches of one detail with another weigh one together, as
/// they are right or wrong together; a detail is what matches inside a station that agree with the scene
/// connect. And a wrong one need not lie anywhere: a share of them, which the matches tell, agrees with
/// cameras before which nothing turns. \param object_pairs  of PossibleObjectPairs().
std::vector<PossiblePair> StationWitnesses(const ScanFeatures& features, const AlignedScene& aligned,
                                           const std::vector<PossiblePair>& object_pairs);

}  // namespace s2gs
