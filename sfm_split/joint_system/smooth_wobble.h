#pragma once

#include <optional>

#include "sfm_split/joint_system/joint_options.h"
#include "sfm_split/joint_system/joint_problem.h"
#include "sfm_split/joint_system/wobble_harmonics.h"

namespace s2gs {

/// Harmonics (all zero) for each camera pose that enough of a problem's images share to tell them, and how
/// far a table's plate wobbles at most. Nothing where no camera pose has enough images.
std::optional<WobblePrior> NoWobble(const JointProblem& problem);

/// The prior of an adjusted problem with its standard deviations as the adjustment found them: of tilts and
/// of shifts, of harmonics about zero and of poses about harmonics. Each is the mean square of what lies
/// about it, over the share of these that keypoints tell, what the prior itself tells not being counted (D.
/// MacKay, Bayesian interpolation, 1992, eq. 4.7 and 4.8), all unknowns being free beside each other. The
/// same prior where there are too many unknowns to tell.
WobblePrior FitDeviations(const JointProblem& problem, const JointOptions& options);

}  // namespace s2gs
