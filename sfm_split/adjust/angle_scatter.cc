#include "sfm_split/adjust/angle_scatter.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "sfm_split/base/rotation.h"
#include "sfm_split/solvers/eigen_solvers.h"

namespace s2gs {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr double kTwoSigmas = 2;       // less of a log-likelihood: two standard deviations
constexpr double kWidthFactor = 1.05;  // between widths that are tried

double LogLikelihood(const std::vector<AngleScatter>& stations, double width_rad) {
  double sum = 0;
  for (const AngleScatter& scatter : stations) {
    for (Eigen::Index k = 0; k < scatter.deviations.size(); ++k) {
      const double variance = scatter.variances(k) + width_rad * width_rad;
      sum -= 0.5 * (std::log(variance) + scatter.deviations(k) * scatter.deviations(k) / variance);
    }
  }
  return sum;
}

}  // namespace

AngleScatter ScatterBeside(const MatrixXd& design, const MatrixXd& covariance, const VectorXd& deviations) {
  const Eigen::Index num = design.rows();
  const MatrixXd q = design.householderQr().householderQ() * MatrixXd::Identity(num, num);
  const MatrixXd left = q.rightCols(num - design.cols());
  const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(MatrixXd(left.transpose() * covariance * left));
  return {eigen.eigenvectors().transpose() * (left.transpose() * deviations),
          eigen.eigenvalues().cwiseMax(0)};
}

double LargestWidthRad(const std::vector<AngleScatter>& stations) {
  double best = LogLikelihood(stations, kLeastWidthRad);
  double width = kLeastWidthRad;
  for (double tried = kLeastWidthRad; tried < kPi; tried *= kWidthFactor) {
    const double here = LogLikelihood(stations, tried);
    best = std::max(best, here);
    if (here >= best - kTwoSigmas) width = tried;
  }
  return width;
}

}  // namespace s2gs
