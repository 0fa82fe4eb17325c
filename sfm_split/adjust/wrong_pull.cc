#include "sfm_split/adjust/wrong_pull.h"

#include <algorithm>
#include <cmath>

#include "sfm_split/joint_system/joint_solve.h"
#include "sfm_split/joint_system/joint_system.h"

namespace s2gs {
namespace {

constexpr double kSharper = 0.5;               // of the error at which the loss turns
constexpr double kWhole = 1 / (1 - kSharper);  // to a loss that turns at once, over the move to that
constexpr double kTolerance = 1e-6;            // of the cost: the move is asked for to a few hundredths
constexpr int kQuadrature = 400;               // quantiles of an error, at which a mean is taken

Eigen::VectorXd ValuesOf(const JointSystem& system, const Observability& observability) {
  Eigen::VectorXd values(static_cast<Eigen::Index>(observability.parameters.size()));
  for (size_t k = 0; k < observability.parameters.size(); ++k) {
    const auto& [block, place] = observability.parameters[k];
    values(static_cast<Eigen::Index>(k)) = system.blocks()[static_cast<size_t>(block)].values[place];
  }
  return values;
}

// The variance of the estimate by a loss, over that by squares, of normal errors: E[psi^2] over sigma^2 and
// the square of the mean curvature, in the plane.
double VarianceOver(const ceres::LossFunction& loss, double sigma_px) {
  double squares = 0;
  double curvature = 0;
  for (int k = 0; k < kQuadrature; ++k) {
    const double squared = -2 * sigma_px * sigma_px * std::log((k + 0.5) / kQuadrature);
    double rho[3];
    loss.Evaluate(squared, rho);
    squares += 0.5 * squared * rho[1] * rho[1] / kQuadrature;
    curvature += (rho[1] + rho[2] * squared) / kQuadrature;
  }
  return squares / (sigma_px * sigma_px * curvature * curvature);
}

}  // namespace

void FillPullOfWrongOnes(const JointProblem& problem, const JointOptions& options, double sigma_px,
                         Reporter& reporter, Observability* observability) {
  if (!observability->computed || options.loss == JointLoss::kSquared) return;
  if (!(options.loss_scale_px > 0 && sigma_px > 0)) return;
  // Priors stay as they weigh in the adjustment.
  const JointSystem system(problem, options, true);
  JointOptions sharper = options;
  sharper.loss_scale_px *= kSharper;
  const Eigen::VectorXd before = ValuesOf(system, *observability);
  SolveSystem(system, sharper, kTolerance, reporter);
  const Eigen::VectorXd move = ValuesOf(system, *observability) - before;
  if (!move.allFinite()) return;
  observability->pull = kWhole * move;
  // The less efficient of two estimates differs from the other by what their variances differ by.
  const double here = VarianceOver(*MakeLoss(options), sigma_px);
  const double there = VarianceOver(*MakeLoss(sharper), sigma_px);
  observability->pull_variance =
      kWhole * kWhole * std::max(0.0, there / here - 1) / problem.priors.chosen_variance;
}

}  // namespace s2gs
