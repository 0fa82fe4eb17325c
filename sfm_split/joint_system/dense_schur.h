#pragma once

#include "sfm_split/base/reporter.h"
#include "sfm_split/joint_system/joint_system.h"

namespace s2gs {

struct DenseSchurOptions {
  int max_iterations = 100;
  double function_tolerance = 1e-8;  ///< relative decrease of the cost at which it stops.
  int num_threads = 0;               ///< 0: all cores.
};

struct DenseSchurSummary {
  double cost = 0;     ///< half the sum of the loss and of the priors' squares.
  int iterations = 0;  ///< taken or not.
  bool converged = false;
};

/// Levenberg-Marquardt on a joint system, points eliminated, what is left solved as a dense matrix: for up to
/// about a thousand camera-side parameters. Steps, damping and ends are those of Ceres' trust region with a
/// Schur complement (Agarwal et al., Ceres Solver, "Nonlinear least squares": columns scaled once, diagonal
/// damping, radius by the ratio of decreases), but for the last step, which is taken here when it helps. All
/// sums go over a partition of the points that does not depend on the threads, so neither does the result.
///
/// Moves the system's free parameters and points to where it ends. Throws Interrupted when the reporter asks
/// to stop.
/// \param loss  of a squared error; null: squared.
DenseSchurSummary SolveDenseSchur(const JointSystem& system, const ceres::LossFunction* loss,
                                  const DenseSchurOptions& options, Reporter& reporter);

}  // namespace s2gs
