#pragma once

#include "sfm_split/adjust/joint_ba.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

/// What observations that are wrong, all to one side, pull the parameters of an adjusted problem by. No
/// covariance counts it, as all of the data have it: but what a robust loss lets them pull by falls with the
/// error at which it turns, and right observations say the same wherever that is (Hausman's test of a
/// specification: two estimates that differ only when it is wrong). So everything is adjusted again with a
/// loss that turns at half the error, and twice the move, as to a loss without any reach, is the pull. Fills
/// the pull and its variance by noise alone; nothing where the loss is that of squares.
/// \param options  those of the adjustment, with its loss' scale.
/// \param sigma_px  standard deviation of a keypoint's coordinate.
/// Throws Interrupted when the reporter asks to stop.
void FillPullOfWrongOnes(const JointProblem& problem, const JointOptions& options, double sigma_px,
                         Reporter& reporter, Observability* observability);

}  // namespace s2gs
