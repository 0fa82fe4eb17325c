#include "sfm_split/turntable/turntable_scale.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <map>

#include "sfm_split/base/infinity.h"
#include "sfm_split/solvers/eigen_solvers.h"
#include "sfm_split/turntable/tukey_reweighting.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;

class OffsetSolver {
 public:
  OffsetSolver(const std::vector<TurntableMeasurement>& all, std::vector<int> use,
               const TurntableAxisFit& axis, std::optional<double> fixed_scale,
               const TurntableOptions& options)
      : all_(all),
        use_(std::move(use)),
        n_(axis.n),
        f_(BasisWithThirdAxis(axis.m)),
        fixed_scale_(fixed_scale),
        options_(options) {
    Vector3d mean = Vector3d::Zero();
    for (const int t : use_) mean += ObjectCentre(all_[t]);
    mean /= static_cast<double>(use_.size());
    double sum = 0;
    for (const int t : use_) sum += (ObjectCentre(all_[t]) - mean).squaredNorm();
    path_ = std::sqrt(sum / static_cast<double>(use_.size()));
    if (path_ <= 0) path_ = 1;
  }

  TurntableOffsetFit Solve(std::mt19937* rng) {
    TurntableOffsetFit fit;
    if (fixed_scale_) fit.scale = *fixed_scale_;
    const bool seeded = FindSeed(rng, &fit);
    if (!seeded) {
      const std::vector<double> weights(use_.size(), 1);
      LeastSquares(use_, weights, &fit);
    }
    fit.length = Length(fit);
    std::vector<double> residuals = Residuals(fit);
    TukeyReweighting reweight{
        seeded ? options_.max_seed_error_rel * fit.length / options_.inlier_sigmas : kInfinity,
        kMaxwellMedian,
        options_.inlier_sigmas,
        kRoundingFloor * fit.length,
        3,
        NumColumns()};
    std::vector<double> weights;
    for (int iteration = 0; iteration < kReweightings; ++iteration) {
      weights = reweight(residuals);
      LeastSquares(use_, weights, &fit);
      residuals = Residuals(fit);
    }
    fit.length = Length(fit);
    Judge(residuals, weights, reweight.sigma, &fit);
    return fit;
  }

 private:
  static Vector3d ObjectCentre(const TurntableMeasurement& t) { return t.a.transpose() * t.from_object; }

  double Length(const TurntableOffsetFit& fit) const { return std::max(std::abs(fit.scale) * path_, 1e-300); }

  std::vector<double> Residuals(const TurntableOffsetFit& fit) const {
    std::vector<double> residuals;
    residuals.reserve(use_.size());
    for (const int t : use_) residuals.push_back(TurntableOffsetResidual(all_[t], fit));
    return residuals;
  }

  // Columns: scale (in units of 1 / path, absent when fixed), p in the basis across m, a.
  int NumColumns() const { return fixed_scale_ ? 5 : 6; }
  Eigen::Matrix<double, 3, Eigen::Dynamic, 0, 3, 6> Rows(const TurntableMeasurement& t) const {
    Eigen::Matrix<double, 3, Eigen::Dynamic, 0, 3, 6> rows(3, NumColumns());
    int column = 0;
    if (!fixed_scale_) rows.col(column++) = t.from_object / path_;
    rows.middleCols<2>(column) = -t.a * f_.leftCols<2>();
    rows.middleCols<3>(column + 2) = Matrix3d::Identity();
    return rows;
  }

  // Minimum-norm solution, so that rank-deficient samples do no harm.
  void LeastSquares(const std::vector<int>& images, const std::vector<double>& weights,
                    TurntableOffsetFit* fit) const {
    MatrixXd rows(3 * images.size(), NumColumns());
    VectorXd right(3 * images.size());
    for (size_t k = 0; k < images.size(); ++k) {
      const TurntableMeasurement& t = all_[images[k]];
      const double root = std::sqrt(weights[k]);
      rows.middleRows<3>(static_cast<Eigen::Index>(3 * k)) = root * Rows(t);
      right.segment<3>(static_cast<Eigen::Index>(3 * k)) =
          root * (fixed_scale_ ? Vector3d(t.centre - *fixed_scale_ * t.from_object) : t.centre);
    }
    Eigen::CompleteOrthogonalDecomposition<MatrixXd> decomposition;
    decomposition.setThreshold(1e-12);
    const VectorXd x = decomposition.compute(rows).solve(right);
    if (!x.allFinite()) return;
    int column = 0;
    if (!fixed_scale_) fit->scale = x(column++) / path_;
    fit->p = f_.leftCols<2>() * x.segment<2>(column);
    fit->a = x.segment<3>(column + 2);
  }

  bool FindSeed(std::mt19937* rng, TurntableOffsetFit* best_fit) const {
    double best = kInfinity;
    const std::vector<double> ones(3, 1);
    const auto pick = [&] { return use_[(*rng)() % use_.size()]; };
    std::vector<int> sample(3);
    for (int seed = 0; seed < options_.max_seeds && use_.size() >= 3; ++seed) {
      for (int& t : sample) t = pick();
      if (sample[0] == sample[1] || sample[0] == sample[2] || sample[1] == sample[2]) continue;
      TurntableOffsetFit fit = *best_fit;
      LeastSquares(sample, ones, &fit);
      if (fit.scale <= 0) continue;
      const double cap = options_.max_seed_error_rel * Length(fit);
      double cost = 0;
      for (const int t : use_) cost += std::min(TurntableOffsetResidual(all_[t], fit) / cap, 1.0);
      if (cost < best) {
        best = cost;
        *best_fit = fit;
      }
    }
    return best < kInfinity;
  }

  void Judge(const std::vector<double>& residuals, const std::vector<double>& weights, double robust_sigma,
             TurntableOffsetFit* fit) const {
    fit->bound = std::max(options_.inlier_sigmas * robust_sigma, options_.min_outlier_rel * fit->length);
    const int columns = NumColumns();
    MatrixXd information = MatrixXd::Zero(columns, columns);
    std::map<int, std::vector<Vector3d>> by_station;
    std::map<int, MatrixXd> gradient_by_station;
    double squares = 0;
    int within = 0;
    for (size_t k = 0; k < use_.size(); ++k) {
      if (residuals[k] <= fit->bound) ++fit->num_inliers;
      if (residuals[k] > options_.inlier_sigmas * robust_sigma) continue;
      const TurntableMeasurement& t = all_[use_[k]];
      const auto rows = Rows(t);
      ++within;
      squares += residuals[k] * residuals[k];
      information += weights[k] * rows.transpose() * rows;
      by_station[t.station].emplace_back(t.centre - fit->scale * t.from_object + t.a * fit->p - fit->a);
      MatrixXd& gradient =
          gradient_by_station.try_emplace(t.station, MatrixXd::Zero(columns, 3)).first->second;
      gradient += weights[k] * rows.transpose();
    }
    if (within == 0) return;
    const int redundancy = 3 * within - columns;
    double variance = redundancy > 0 ? squares / redundancy : kInfinity;

    // Noise that the images of a station share (its own pose's) and noise of single images.
    const int stations = static_cast<int>(by_station.size());
    double station_variance = 0;
    if (stations > 1 && within > stations + 1) {
      double inside = 0;
      double between = 0;
      double inverse_counts = 0;
      for (const auto& [station, vectors] : by_station) {
        Vector3d mean = Vector3d::Zero();
        for (const Vector3d& r : vectors) mean += r;
        mean /= static_cast<double>(vectors.size());
        for (const Vector3d& r : vectors) inside += (r - mean).squaredNorm();
        between += mean.squaredNorm();
        inverse_counts += 1.0 / static_cast<double>(vectors.size());
      }
      variance = inside / std::max(1, 3 * (within - stations) - 2);
      const int left = 3 * stations - (fixed_scale_ ? 3 : 4);
      station_variance = std::max(0.0, between - 3 * variance * inverse_counts) / left;
    }
    fit->sigma = std::max(std::sqrt(variance), kRoundingFloor * fit->length);
    fit->centre_sigma = std::sqrt(station_variance);

    const VectorXd column_scale = information.diagonal().cwiseSqrt();
    const MatrixXd normalised =
        column_scale.cwiseInverse().asDiagonal() * information * column_scale.cwiseInverse().asDiagonal();
    const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(normalised);
    for (int k = columns - 1; k >= 0; --k) {
      fit->singular_values.push_back(std::sqrt(std::max(0.0, eigen.eigenvalues()(k))));
    }
    // Eigenvalues are the squares of singular values: 1e-13 here is 3e-7 there.
    const VectorXd inverse_values =
        (eigen.eigenvalues().array() > 1e-13)
            .select(eigen.eigenvalues().cwiseInverse(), VectorXd::Constant(columns, kInfinity));
    if (!inverse_values.allFinite() || !std::isfinite(variance)) return;
    const MatrixXd half = column_scale.cwiseInverse().asDiagonal() * eigen.eigenvectors();
    const MatrixXd inverse = half * inverse_values.asDiagonal() * half.transpose();
    MatrixXd covariance = fit->sigma * fit->sigma * inverse;
    for (const auto& [station, gradient] : gradient_by_station) {
      const MatrixXd lever = inverse * gradient;
      covariance += station_variance * lever * lever.transpose();
    }
    if (!fixed_scale_) fit->scale_sigma = std::sqrt(covariance(0, 0)) / path_;
    const Matrix3d across = Matrix3d::Identity() - n_ * n_.transpose();
    const Matrix3d of_a = across * covariance.bottomRightCorner<3, 3>() * across;
    fit->point_sigma = std::sqrt(Eigen::SelfAdjointEigenSolver<Matrix3d>(of_a).eigenvalues()(2));
  }

  const std::vector<TurntableMeasurement>& all_;
  std::vector<int> use_;
  Vector3d n_;
  Matrix3d f_;
  std::optional<double> fixed_scale_;
  const TurntableOptions& options_;
  double path_ = 1;  // of the camera about the object, object units
};

}  // namespace

double TurntableOffsetResidual(const TurntableMeasurement& t, const TurntableOffsetFit& fit) {
  return (t.centre - fit.scale * t.from_object + t.a * fit.p - fit.a).norm();
}

TurntableOffsetFit FitTurntableOffset(const std::vector<TurntableMeasurement>& all,
                                      const std::vector<int>& use, const TurntableAxisFit& axis,
                                      std::optional<double> fixed_scale, const TurntableOptions& options,
                                      std::mt19937* rng) {
  return OffsetSolver(all, use, axis, fixed_scale, options).Solve(rng);
}

}  // namespace s2gs
