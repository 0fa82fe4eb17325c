#include "sfm_split/joint_system/observability.h"

#include <ceres/loss_function.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <memory>
#include <utility>

#include "sfm_split/joint_system/joint_system.h"
#include "sfm_split/joint_system/reduced_system.h"
#include "sfm_split/joint_system/score_covariance.h"
#include "sfm_split/solvers/eigen_solvers.h"

namespace s2gs {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

// Eigenvalues of the reduced system, with unit diagonal before the points' elimination, that are below this
// times the largest are zero: rounding leaves about 1e-15.
constexpr double kZeroEigenvalue = 1e-12;
constexpr double kRounding = 1e-16;
// Of what a sum of parameters is made of: rounding leaves the square of kZeroEigenvalue at most.
constexpr double kUntoldShare = 1e-6;

std::string ColumnName(const JointSystem& system, const JointProblem& problem, const ReducedColumn& column) {
  const std::string& block = system.blocks()[column.block].name;
  const int first_camera = system.IntrinsicsBlock(0);
  if (column.block < first_camera) return block + (column.value < 3 ? " rotation" : " centre");
  if (column.block < first_camera + static_cast<int>(problem.cameras.size())) {
    const CameraModelInfo& info = InfoOf(problem.cameras[column.block - first_camera].model);
    const auto k = static_cast<size_t>(column.value);
    return block + (k < info.num_focal_params    ? " focal length"
                    : k < info.FirstExtraParam() ? " principal point"
                                                 : " distortion");
  }
  if (problem.free_object) return block + (column.value < 3 ? " rotation" : " translation");
  if (column.block == system.AxisBlock()) return column.value < 2 ? "axis direction" : "axis position";
  return block;
}

// The shares of a direction by name, largest first, e.g. "axis position 70 %, camera 0 focal length 20 %".
std::string Describe(const VectorXd& direction, const std::vector<std::string>& names) {
  std::map<std::string, double> shares;
  for (Eigen::Index k = 0; k < direction.size(); ++k) {
    const std::string& name = names[static_cast<size_t>(k)];
    const bool of_image = name.rfind("angle of ", 0) == 0 || name.rfind("object at ", 0) == 0;
    shares[of_image ? name.substr(0, name.find(' ')) + (name[0] == 'a' ? "s" : " poses") : name] +=
        direction(k) * direction(k);
  }
  std::vector<std::pair<double, std::string>> sorted;
  sorted.reserve(shares.size());
  for (const auto& [name, share] : shares) sorted.emplace_back(-share, name);
  std::sort(sorted.begin(), sorted.end());
  std::string text;
  for (size_t k = 0; k < sorted.size() && k < 3; ++k) {
    const int percent = static_cast<int>(std::lround(-100 * sorted[k].first));
    if (k > 0 && percent < 5) break;
    text += (k > 0 ? ", " : "") + sorted[k].second + " " + std::to_string(percent) + " %";
  }
  return text;
}

}  // namespace

bool IsUntold(const Observability& observability, const VectorXd& weights) {
  const VectorXd along = observability.directions.transpose() * weights;
  return along.head(observability.nullity).squaredNorm() > kUntoldShare * along.squaredNorm();
}

Observability AnalyzeObservability(const JointProblem& problem, const JointOptions& asked, bool fix_gauge,
                                   double sigma_px) {
  JointOptions options = asked;
  if (options.loss_scale_px == 0) options.loss_scale_px = LossScalePx(sigma_px);
  Observability result;
  const JointSystem system(problem, options, fix_gauge);
  const int free = system.NumFree();
  result.num_parameters = free;
  if (free == 0 || free > options.max_dense_parameters) return result;

  const std::unique_ptr<ceres::LossFunction> loss = MakeLoss(options);
  const ReducedSystem reduced = Reduce(problem, system, loss.get(), options.num_threads);
  for (const ReducedColumn& column : reduced.columns) {
    result.names.push_back(ColumnName(system, problem, column));
    result.parameters.emplace_back(column.block, column.value);
  }
  const double share = CurvatureShare(reduced.loss);
  const bool has_priors = !system.priors().empty();
  VectorXd diagonal = reduced.diagonal;
  MatrixXd with_priors = reduced.s;
  PriorSums priors;
  if (has_priors) {
    // S stands for the robust cost's second derivatives over the share.
    priors = SumPriors(system, reduced);
    with_priors += priors.information / share;
    diagonal += priors.information.diagonal() / share;
    priors.of_gradients /= share * share;
    priors.known_before /= share * share;
  }
  const VectorXd scale =
      (diagonal.array() > 0).select(diagonal.array().sqrt().inverse(), VectorXd::Zero(free).array());
  const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(
      MatrixXd(scale.asDiagonal() * with_priors * scale.asDiagonal()));
  result.computed = true;
  result.eigenvalues = eigen.eigenvalues();
  const double largest = std::max(eigen.eigenvalues()(free - 1), std::numeric_limits<double>::min());
  while (result.nullity < free && eigen.eigenvalues()(result.nullity) <= kZeroEigenvalue * largest) {
    result.null_directions.push_back(Describe(eigen.eigenvectors().col(result.nullity), result.names));
    ++result.nullity;
  }
  const auto rounding = kRounding * largest;
  const double not_counted =
      result.nullity > 0 ? std::max(eigen.eigenvalues()(result.nullity - 1), rounding) : rounding;
  if (result.nullity < free) {
    result.gap = eigen.eigenvalues()(result.nullity) / not_counted;
    result.condition = largest / eigen.eigenvalues()(result.nullity);
  }
  VectorXd inverse = VectorXd::Zero(free);
  for (int k = result.nullity; k < free; ++k) inverse(k) = 1 / eigen.eigenvalues()(k);
  const MatrixXd half = scale.asDiagonal() * eigen.eigenvectors();
  result.directions = half;
  const MatrixXd inverse_system = half * inverse.asDiagonal() * half.transpose();
  const double chosen = problem.priors.chosen_variance;
  const double variance =
      chosen * NormalVarianceFactor(loss.get(), reduced.loss, sigma_px) * sigma_px * sigma_px;
  result.covariance = variance * inverse_system;
  MatrixXd of_priors;
  if (has_priors) {
    result.prior_covariance = inverse_system * priors.known_before * inverse_system;
    of_priors = inverse_system * priors.of_gradients * inverse_system;
    result.covariance = variance * inverse_system * reduced.s * inverse_system + of_priors;
  }
  const double of_scores = chosen / (share * share);
  const ScoreCovariance scores = CovarianceOfScores(reduced, inverse_system, options.num_threads);
  result.robust_covariance = of_scores * inverse_system * scores.of_points * inverse_system;
  result.regional_covariance = of_scores * inverse_system * scores.of_regions * inverse_system;
  result.ring_covariance = of_scores * inverse_system * scores.of_rings * inverse_system;
  if (has_priors) {
    result.ring_covariance += of_priors;
    result.robust_covariance += of_priors;
    result.regional_covariance += of_priors;
  }
  return result;
}

}  // namespace s2gs
