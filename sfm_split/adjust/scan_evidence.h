#pragma once

#include <string>
#include <vector>

#include "sfm_split/adjust/joint_ba.h"
#include "sfm_split/adjust/verdict.h"
#include "sfm_split/scene/scan_features.h"

namespace s2gs {

/// Keypoints that no adjustment may see, by image and keypoint.
using HeldBackKeypoints = std::vector<std::vector<bool>>;

/// A tenth of what is matched: of the sets of keypoints that verified matches of the object tie together,
/// those that a hash of their first keypoint chooses. Sets with two keypoints of one photo hold a wrong
/// match, and are never chosen. The same features give the same choice.
HeldBackKeypoints HoldBack(const ScanFeatures& features);

/// What the matches say of poses that were adjusted without the keypoints held back.
/// \param joint         of the last adjustment.
/// \param max_error_px  distance from its epipolar line at which a match agrees.
ScanEvidence GatherEvidence(const ScanFeatures& features, const TurntableScene& scene,
                            const JointReport& joint, const HeldBackKeypoints& held_back,
                            double max_error_px);

/// The same of photos that were taken for one rigid body. \param placed  how many have a pose.
ScanEvidence GatherOneBodyEvidence(const ScanFeatures& features, const std::vector<Camera>& cameras,
                                   int placed);

}  // namespace s2gs
