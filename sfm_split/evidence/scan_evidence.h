#pragma once

#include <vector>

#include "sfm_split/adjust/joint_ba.h"
#include "sfm_split/evidence/held_back.h"
#include "sfm_split/evidence/match_findings.h"
#include "sfm_split/evidence/verdict.h"
#include "sfm_split/joint_system/joint_priors.h"
#include "sfm_split/scene/scan_features.h"

namespace s2gs {

/// What the matches say of poses that were adjusted without the keypoints held back.
/// \param aligned       the scene, with the object's points.
/// \param joint         of the last adjustment. \param turns  what table angles lie about in it, by the
/// places of the scene's views. \param max_error_px  distance from its epipolar line at which a match agrees.
ScanEvidence GatherEvidence(const ScanFeatures& features, const AlignedScene& aligned,
                            const JointReport& joint, const std::vector<EqualStepsPrior>& turns,
                            const HeldBackKeypoints& held_back, const MatchFindings& findings,
                            double max_error_px);

/// The same of photos that were taken for one rigid body. \param cam_from_world  of those that have a pose.
ScanEvidence GatherOneBodyEvidence(const ScanFeatures& features, const std::vector<Camera>& cameras,
                                   const std::vector<Rigid3>& cam_from_world);

}  // namespace s2gs
