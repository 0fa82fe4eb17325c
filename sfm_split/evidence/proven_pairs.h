#pragma once

#include <cstdint>
#include <set>
#include <utility>

#include "sfm_split/evidence/posed_matches.h"
#include "sfm_split/evidence/verdict.h"

namespace s2gs {

/// Keypoints, as image and index.
using KeypointSet = std::set<std::pair<int, uint32_t>>;

/// What pairs of photos of one station prove by themselves (ProvePair): of photos next to each other by name,
/// and of a station's last photos with its first, which close a turn or do not. Returns the keypoints of
/// bodies that the poses are not of.
KeypointSet RecordProvenPairs(const PosedMatches& matches, ScanEvidence* evidence);

}  // namespace s2gs
