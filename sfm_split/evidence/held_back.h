#pragma once

#include <cstdint>
#include <limits>
#include <vector>

#include "sfm_split/scene/scan_features.h"

namespace s2gs {

/// Of a keypoint that no match ties to another.
inline constexpr uint32_t kNoSet = std::numeric_limits<uint32_t>::max();

/// Numbers of sets, by image and keypoint.
using KeypointSets = std::vector<std::vector<uint32_t>>;

/// The sets of keypoints that verified matches of the object tie together, as views of one detail. A match
/// that would put two keypoints of one photo into a set ties nothing: of it and those that did, it is the one
/// that fewest others bear out. One of its ends has a set all the same.
KeypointSets SetsOfKeypoints(const ScanFeatures& features);

/// Keypoints that no adjustment may see, by image and keypoint.
using HeldBackKeypoints = std::vector<std::vector<bool>>;

/// A tenth of what is matched: of these sets those that a hash of their first keypoint chooses, sets of right
/// and of wrong matches alike. The same features give the same choice.
HeldBackKeypoints HoldBack(const ScanFeatures& features);

}  // namespace s2gs
