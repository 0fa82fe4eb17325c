#pragma once

#include <Eigen/Core>
#include <optional>

#include "sfm_split/adjust/joint_ba.h"
#include "sfm_split/joint_system/joint_solve.h"

namespace s2gs {

/// Where lenses' axes meet the photos, as the data tell it: photos that were cut from larger ones do not have
/// it in their middle. With a principal point that is held wrongly a station's camera turns a little, and
/// focal length and distortion take the rest, so that residuals hardly show it.
struct FreedPrincipalPoint {
  JointProblem problem;  ///< adjusted, with a prior for the principal points (LensPrior::principal).
  JointSolved solved;
  PrincipalPointTest test;
};

/// Fits a problem once more with principal points free, from several places, as far as it may pay.
/// \param options  those of the adjustment, with its loss' scale.
/// \param held_problem  adjusted, with principal points held, which lie where they are expected: that is the
/// mean of their prior.
/// \param held  what adjusting it gave.
/// Throws Interrupted when the reporter asks to stop.
FreedPrincipalPoint FitPrincipalPoint(const JointOptions& options, const JointProblem& held_problem,
                                      const JointSolved& held, Reporter& reporter);

/// Twice the logarithm of the odds for free principal points by how far they came from the means of their
/// priors, against standard deviations as the results state them, the Bayesian information criterion's share
/// for their number off: errors that the points of one region or ring have in common move what all photos
/// share, and neither residuals nor the photos' own scores show it. Nothing where deviations are not known.
/// \param options  those of the adjustment, with its loss' scale.
/// \param freed  adjusted, with a prior for the principal points. \param solved  what adjusting it gave.
std::optional<double> TwiceLogOddsByShift(const JointOptions& options, const JointProblem& freed,
                                          const JointSolved& solved);

/// The prior of a cut photo's principal point, which is free by it.
PrincipalPointPrior CutPhotoPrior(const Camera& camera, const Eigen::Vector2d& expected_px);

}  // namespace s2gs
