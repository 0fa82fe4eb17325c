#pragma once

#include <cstdint>
#include <vector>

#include "sfm_split/scene/features.h"
#include "sfm_split/split/stations.h"

namespace s2gs {

/// For chosen keypoints of one photo the keypoint at the same pixel of another photo of the same station, or
/// kNoKeypoint. The photos' common shift (shake) is found first, as the most frequent displacement; where
/// chance could explain how many share it, there are none. \param usable  per keypoint of the other photo:
/// whether it may answer.
std::vector<uint32_t> FindUnmovedKeypoints(const Keypoints& keypoints, const std::vector<uint32_t>& chosen,
                                           const Keypoints& others, const std::vector<bool>& usable,
                                           float max_shake_px, float max_distance_px);

}  // namespace s2gs
