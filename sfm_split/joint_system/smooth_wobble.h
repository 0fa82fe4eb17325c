#pragma once

#include <optional>
#include <vector>

#include "sfm_split/joint_system/joint_options.h"
#include "sfm_split/joint_system/joint_problem.h"
#include "sfm_split/joint_system/wobble_harmonics.h"

namespace s2gs {

/// One for each camera pose that enough of a problem's images share to tell its coefficients: zeros.
std::vector<WobbleHarmonics> NoHarmonics(const JointProblem& problem);

/// The harmonics that a problem's free object poses lie about, and how closely, as the keypoints that see
/// each tell it, all else being held. Nothing where no station has enough images.
std::optional<WobblePrior> FitHarmonics(const JointProblem& problem, const JointOptions& options,
                                        double sigma_px);

}  // namespace s2gs
