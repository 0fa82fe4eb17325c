#pragma once

#include <string>

#include "sfm_split/base/reporter.h"
#include "sfm_split/joint_system/joint_options.h"
#include "sfm_split/joint_system/joint_problem.h"
#include "sfm_split/joint_system/joint_system.h"

namespace s2gs {

struct JointSolved {
  double cost = 0;     ///< sum of the loss over observations (not halved).
  int parameters = 0;  ///< free ones, points included.
  int residuals = 0;   ///< coordinates of active observations, by their weights.
  int iterations = 0;
  bool converged = false;
  std::string linear_solver;
};

/// Adjusts a problem's active observations once, in place. The options' loss has a scale.
/// Throws Interrupted when the reporter asks to stop.
JointSolved SolveJointOnce(const JointOptions& options, double function_tolerance, Reporter& reporter,
                           JointProblem* problem);

/// The same for a system as it stands, whose free parameters and points are moved. The options' loss may be
/// another than that the system's priors were weighed by.
JointSolved SolveSystem(const JointSystem& system, const JointOptions& options, double function_tolerance,
                        Reporter& reporter);

}  // namespace s2gs
