#include "sfm_split/joint_system/smooth_wobble.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <map>
#include <memory>
#include <utility>
#include <vector>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/joint_system/joint_system.h"
#include "sfm_split/joint_system/reduced_system.h"

namespace s2gs {
namespace {

using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;

constexpr size_t kLeastImages = 2 * WobbleHarmonics::kTerms;  // as many tell how they scatter
constexpr double kMostWobble = kDegree;                       // a table's plate wobbles by up to a degree
// Of a variance in one step: all is found anew after it.
constexpr double kMostGrowth = 100;
constexpr double kMostFall = 0.01;
// Of what lies about a prior: where keypoints tell less, it holds nearly all, and a smaller one changes
// nothing but how stiff the equations are.
constexpr double kHeldShare = 0.02;

// How far the object reaches from the axis' point [world units]: the median of its points.
double ReachOf(const JointProblem& problem) {
  std::vector<double> reaches;
  for (const Vector3d& x : problem.object.points) reaches.push_back((x - problem.AxisPoint()).norm());
  return reaches.empty() ? 1 : UpperMedian(std::move(reaches));
}

// The covariance of a system's unknowns with all that is known before, by its columns, over the square of its
// priors' scale in pixels; empty where it has no inverse.
MatrixXd PosteriorCovariance(const JointSystem& system, const ReducedSystem& reduced) {
  const double share = CurvatureShare(reduced.loss);
  const MatrixXd known = share * reduced.s + SumPriors(system, reduced).information;
  const VectorXd scale =
      (known.diagonal().array() > 0)
          .select(known.diagonal().array().sqrt().inverse(), VectorXd::Ones(known.rows()).array());
  const Eigen::LLT<MatrixXd> root(MatrixXd(scale.asDiagonal() * known * scale.asDiagonal()));
  if (root.info() != Eigen::Success) return {};
  return scale.asDiagonal() * MatrixXd(root.solve(MatrixXd::Identity(known.rows(), known.rows()))) *
         scale.asDiagonal();
}

}  // namespace

std::optional<WobblePrior> NoWobble(const JointProblem& problem) {
  std::map<int, WobbleHarmonics> of_pose;
  for (size_t i = 0; i < problem.images.size(); ++i)
    of_pose[problem.images[i].pose].images.push_back(static_cast<int>(i));
  WobblePrior prior;
  for (auto& [pose, wobble] : of_pose) {
    if (wobble.images.size() >= kLeastImages) prior.harmonics.push_back(std::move(wobble));
  }
  if (prior.harmonics.empty()) return std::nullopt;
  prior.sigma_tilt_rad = prior.sigma_harmonic_tilt_rad = kMostWobble;
  prior.sigma_shift = prior.sigma_harmonic_shift = kMostWobble * ReachOf(problem);
  return prior;
}

WobblePrior FitDeviations(const JointProblem& problem, const JointOptions& options) {
  WobblePrior prior = *problem.priors.wobble;
  const JointSystem system(problem, options, true);
  if (system.NumFree() > options.max_dense_parameters) return prior;
  const std::unique_ptr<ceres::LossFunction> loss = MakeLoss(options);
  const ReducedSystem reduced = Reduce(problem, system, loss.get(), options.num_threads);
  const MatrixXd covariance = PosteriorCovariance(system, reduced);
  if (covariance.size() == 0) return prior;
  const auto fit = [&](const std::vector<size_t>& terms, double* sigma) {
    double squares = 0;
    double told = 0;
    for (const size_t t : terms) {
      const PriorTerm& term = system.priors()[t];
      const PriorRow row = RowOf(term, system, reduced);
      // In the priors' scale, by whose inflation data count less against them (JointPriors).
      squares += row.residual * row.residual / (term.scale_px * term.scale_px);
      told += std::clamp(1 - row.by_columns.dot(covariance * row.by_columns), 0.0, 1.0);
    }
    if (!(told > 0)) return;
    const bool is_held = told < kHeldShare * static_cast<double>(terms.size());
    *sigma *= std::sqrt(std::clamp(squares / told, is_held ? 1.0 : kMostFall, kMostGrowth));
  };
  const JointSystem::WobbleTerms& terms = system.wobble_terms();
  fit(terms.tilts, &prior.sigma_tilt_rad);
  fit(terms.shifts, &prior.sigma_shift);
  fit(terms.harmonic_tilts, &prior.sigma_harmonic_tilt_rad);
  fit(terms.harmonic_shifts, &prior.sigma_harmonic_shift);
  return prior;
}

}  // namespace s2gs
