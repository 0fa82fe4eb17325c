#pragma once

#include "sfm_split/adjust/joint_ba.h"

namespace s2gs {

/// Standard deviations of what users ask for (axis, angles, focal lengths, scale) from the covariances that
/// the report's observability holds; nothing when it has none.
void FillSigmas(const JointProblem& problem, const JointOptions& options, JointReport* report);

}  // namespace s2gs
