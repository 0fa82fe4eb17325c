#include "sfm_split/turntable/turntable_axis.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <utility>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/infinity.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/solvers/eigen_solvers.h"
#include "sfm_split/turntable/tukey_reweighting.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

// The samples to try: all of them when there are few.
std::vector<std::pair<int, int>> PairsToTry(int n, int max_pairs, std::mt19937* rng) {
  std::vector<std::pair<int, int>> pairs;
  if (static_cast<int64_t>(n) * (n - 1) / 2 <= max_pairs) {
    for (int i = 0; i < n; ++i) {
      for (int j = i + 1; j < n; ++j) pairs.emplace_back(i, j);
    }
    return pairs;
  }
  while (static_cast<int>(pairs.size()) < max_pairs) {
    const int i = static_cast<int>((*rng)() % static_cast<uint32_t>(n));
    const int j = static_cast<int>((*rng)() % static_cast<uint32_t>(n));
    if (i != j) pairs.emplace_back(i, j);
  }
  return pairs;
}

}  // namespace

double TurntableAxisResidual(const TurntableMeasurement& t, const Vector3d& n, const Vector3d& m) {
  const Vector3d turned = t.a * m;
  return std::atan2(turned.cross(n).norm(), turned.dot(n));
}

TurntableAxisFit FitTurntableAxis(const std::vector<TurntableMeasurement>& all, const std::vector<int>& use,
                                  const TurntableOptions& options, std::mt19937* rng) {
  TurntableAxisFit fit;
  const double cap = options.max_seed_error_deg * kDegree;
  double best = kInfinity;
  for (const auto& [i, j] : PairsToTry(static_cast<int>(use.size()), options.max_seeds, rng)) {
    const TurntableMeasurement& first = all[use[i]];
    const Vector3d w = LogRotation<double>(Matrix3d(first.a * all[use[j]].a.transpose()));
    if (w.norm() < 1e-12) continue;
    const Vector3d n = w.normalized();
    const Vector3d m = first.a.transpose() * n;
    double cost = 0;
    for (const int t : use) cost += std::min(TurntableAxisResidual(all[t], n, m), cap);
    if (cost < best) {
      best = cost;
      fit.n = n;
      fit.m = m;
    }
  }
  if (best == kInfinity) return fit;

  std::vector<double> residuals(use.size());
  const auto measure = [&] {
    for (size_t k = 0; k < use.size(); ++k) residuals[k] = TurntableAxisResidual(all[use[k]], fit.n, fit.m);
  };
  measure();
  TukeyReweighting reweight{
      cap / options.inlier_sigmas, kRayleighMedian, options.inlier_sigmas, kRoundingFloor, 2, 4};
  std::vector<double> weights;
  for (int iteration = 0; iteration < kReweightings; ++iteration) {
    weights = reweight(residuals);
    Matrix3d sum = Matrix3d::Zero();
    for (size_t k = 0; k < use.size(); ++k) sum += weights[k] * all[use[k]].a;
    const Eigen::JacobiSVD<Matrix3d> svd(sum, Eigen::ComputeFullU | Eigen::ComputeFullV);
    if (svd.singularValues()(0) == 0) break;
    const double sign = svd.matrixU().col(0).dot(fit.n) < 0 ? -1 : 1;
    fit.n = sign * svd.matrixU().col(0);
    fit.m = sign * svd.matrixV().col(0);
    measure();
  }

  fit.bound = std::max(options.inlier_sigmas * reweight.sigma, options.min_outlier_deg * kDegree);
  const Matrix3d e = BasisWithThirdAxis(fit.n);
  const Matrix3d f = BasisWithThirdAxis(fit.m);
  Eigen::Matrix4d information = Eigen::Matrix4d::Zero();
  double cosine = 0;
  double sine = 0;
  double squares = 0;
  int within = 0;
  for (size_t k = 0; k < use.size(); ++k) {
    if (residuals[k] <= fit.bound) ++fit.num_inliers;
    if (residuals[k] > options.inlier_sigmas * reweight.sigma) continue;
    ++within;
    squares += residuals[k] * residuals[k];
    const Matrix3d turn = e.transpose() * all[use[k]].a * f;  // R_z(theta) up to noise
    Eigen::Matrix<double, 2, 4> jacobian;
    jacobian << -Eigen::Matrix2d::Identity(), turn.topLeftCorner<2, 2>();
    information += jacobian.transpose() * jacobian;
    const double angle = std::atan2(turn(1, 0) - turn(0, 1), turn(0, 0) + turn(1, 1));
    cosine += std::cos(angle);
    sine += std::sin(angle);
  }
  if (within == 0) return fit;
  const double q2 = (cosine * cosine + sine * sine) / (static_cast<double>(within) * within);
  fit.spread = std::sqrt(std::max(0.0, 1 - q2));
  fit.sigma = within > 2 ? std::max(std::sqrt(squares / (2 * within - 4)), kRoundingFloor) : kInfinity;
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix4d> eigen(information);
  if (eigen.eigenvalues()(0) > 1e-14 * eigen.eigenvalues()(3)) {
    const Eigen::Matrix2d covariance = information.inverse().topLeftCorner<2, 2>();
    const double worst = Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(covariance).eigenvalues()(1);
    // Two images leave no redundancy: their axis is as good as their own turn allows for a small noise.
    fit.axis_sigma = std::sqrt(worst) * (within > 2 ? fit.sigma : kRoundingFloor);
  }
  return fit;
}

}  // namespace s2gs
