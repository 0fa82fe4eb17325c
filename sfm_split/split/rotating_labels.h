#pragma once

#include <vector>

#include "sfm_split/split/motion_split.h"
#include "sfm_split/split/split_matching.h"

namespace s2gs {

/// Final labels and object pairs from the verified pairs and what stood still: a keypoint rotates when enough
/// matches say so and more of them than photos that show it unmoved. Matches of keypoints that do not rotate
/// are taken out of object_pairs.
/// \param still  per image, per keypoint: photos that show it unmoved; empty when that was not looked at.
void LabelRotatingKeypoints(const SplitMatching& matching, const std::vector<std::vector<int>>& still,
                            MotionSplit* split);

}  // namespace s2gs
