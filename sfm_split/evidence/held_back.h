#pragma once

#include <vector>

#include "sfm_split/scene/scan_features.h"

namespace s2gs {

/// Keypoints that no adjustment may see, by image and keypoint.
using HeldBackKeypoints = std::vector<std::vector<bool>>;

/// A tenth of what is matched: of the sets of keypoints that verified matches of the object tie together,
/// those that a hash of their first keypoint chooses. Sets with two keypoints of one photo hold a wrong
/// match, and are never chosen. The same features give the same choice.
HeldBackKeypoints HoldBack(const ScanFeatures& features);

}  // namespace s2gs
