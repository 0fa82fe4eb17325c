#pragma once

#include "sfm_split/split/motion_split.h"
#include "sfm_split/split/split_matching.h"
#include "sfm_split/split/still_keypoints.h"

namespace s2gs {

/// Of a station's photos that must show a background keypoint.
constexpr double kMinStaticShare = 0.25;

/// Labels what stands still in enough photos of its station, of `split`'s stations; images with given labels
/// keep them. Returns how many photos show each keypoint unmoved.
StillSupport LabelStaticKeypoints(const SplitMatching& matching, MotionSplit* split);

/// A photo without companions: what follows the background of other stations is its background.
void LabelPhotosOfTheirOwn(SplitMatching* matching, MotionSplit* split);

/// Descriptors of the image's keypoints with that label.
PackedDescriptors PackLabel(const SplitImage& image, const std::vector<KeypointLabel>& labels,
                            KeypointLabel label);

}  // namespace s2gs
