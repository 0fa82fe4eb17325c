#include "sfm_split/joint_system/dense_schur.h"

#include <Eigen/Cholesky>
#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "sfm_split/base/error.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/joint_system/linearised_system.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::VectorXd;
using PointRows = Eigen::Matrix<double, Eigen::Dynamic, 3>;  // of columns, by the point's coordinates
using Row = LinearisedSystem::Row;
using PriorRow = LinearisedSystem::PriorRow;

// A pass over so many observations takes about a millisecond, far longer than to wake a thread and wait for
// it.
constexpr size_t kTermsOfAThread = 1000;
// Of a point's columns, from where on the matrix' memory is what its elimination waits for: cameras that are
// free.
constexpr size_t kManyColumns = 100;
// Of a matrix' columns, which a thread sums over the parts: some 100 us where there are 600.
constexpr int kColumnsAtOnce = 64;

// Ceres' defaults.
constexpr double kFirstRadius = 1e4;
constexpr double kMaxRadius = 1e16;
constexpr double kMinRadius = 1e-32;
constexpr double kMinDiagonal = 1e-6;
constexpr double kMaxDiagonal = 1e32;
constexpr double kMinRelativeDecrease = 1e-3;
constexpr int kMaxInvalidSteps = 5;
// Rounding of a double alone.
constexpr double kGradientTolerance = 1e-14;
constexpr double kParameterTolerance = 1e-14;

int ThreadsFor(const JointSystem& system, int asked) {
  return static_cast<int>(std::clamp<size_t>(system.terms().size() / kTermsOfAThread, 1,
                                             static_cast<size_t>(NumThreadsOf(asked))));
}

class Solver {
 public:
  Solver(const JointSystem& system, const ceres::LossFunction* loss, const DenseSchurOptions& options)
      : num_threads_(ThreadsFor(system, options.num_threads)), system_(system, loss, num_threads_) {
    step_.setZero(system_.num_columns());
    inverses_.resize(system_.points().size());
    point_steps_.assign(system_.points().size(), Vector3d::Zero());
    complements_.resize(LinearisedSystem::kParts);
  }

  DenseSchurSummary Solve(const DenseSchurOptions& options, Reporter& reporter);

 private:
  struct Complement {
    MatrixXd matrix;  // lower triangle
    VectorXd right;
  };

  // Damped by the radius. False when the matrix is not positive definite.
  bool FindStep(double radius);
  void EliminatePart(size_t part, double radius);
  static void SubtractPoint(const std::vector<int>& columns, const PointRows& times_inverse,
                            const PointRows& by_both, MatrixXd* sum);
  void SumComplements();
  double ModelDecrease();

  int num_threads_;
  LinearisedSystem system_;
  VectorXd step_;  // scaled, as the points'
  std::vector<Vector3d> point_steps_;
  std::vector<Matrix3d> inverses_;       // of the points' damped blocks
  std::vector<Complement> complements_;  // of the parts
};

double Damping(double square, double radius) {
  return std::clamp(square, kMinDiagonal, kMaxDiagonal) / radius;
}

// What eliminating a point of many columns takes from the cameras' matrix: each of its columns' rows times
// those of the columns before it, down a column of the matrix, as it lies in memory. The same bits.
void Solver::SubtractPoint(const std::vector<int>& columns, const PointRows& times_inverse,
                           const PointRows& by_both, MatrixXd* sum) {
  const size_t count = columns.size();
  const double* const x = times_inverse.col(0).data();
  const double* const y = times_inverse.col(1).data();
  const double* const z = times_inverse.col(2).data();
  for (size_t l = 0; l < count; ++l) {
    const auto at = static_cast<Eigen::Index>(l);
    const double by_x = by_both(at, 0), by_y = by_both(at, 1), by_z = by_both(at, 2);
    const int other = columns[l];
    for (size_t k = l; k < count;) {
      // Columns that follow each other: a block's.
      size_t end = k + 1;
      while (end < count && columns[end] == columns[end - 1] + 1) ++end;
      if (columns[k] >= other) {
        double* const to = &(*sum)(columns[k], other);
        for (size_t i = k; i < end; ++i) to[i - k] -= x[i] * by_x + (y[i] * by_y + z[i] * by_z);
        k = end;
      } else {
        for (; k < end; ++k) {
          (*sum)(std::max(columns[k], other), std::min(columns[k], other)) -=
              x[k] * by_x + (y[k] * by_y + z[k] * by_z);
        }
      }
    }
  }
}

void Solver::EliminatePart(size_t part, double radius) {
  Complement& sum = complements_[part];
  sum.matrix.setZero(system_.num_columns(), system_.num_columns());
  sum.right.setZero(system_.num_columns());
  std::vector<int> columns;
  std::vector<int> place_of(static_cast<size_t>(system_.num_columns()), -1);
  PointRows by_both, times_inverse;
  for (size_t p = system_.PartBegin(part); p < system_.PartEnd(part); ++p) {
    const LinearisedSystem::Point& point = system_.points()[p];
    Matrix3d block = Matrix3d::Zero();
    columns.clear();
    for (size_t at = point.begin; at < point.end; ++at) {
      const Row& row = system_.rows()[at];
      block += row.by_point.transpose() * row.by_point;
      for (int k = 0; k < row.size; ++k) {
        const int column = row.columns[static_cast<size_t>(k)];
        int& place = place_of[static_cast<size_t>(column)];
        if (place >= 0) continue;
        place = static_cast<int>(columns.size());
        columns.push_back(column);
      }
    }
    for (int k = 0; k < 3; ++k) block(k, k) += Damping(point.squares(k), radius);
    inverses_[p] = block.inverse();
    by_both.setZero(static_cast<Eigen::Index>(columns.size()), 3);
    for (size_t at = point.begin; at < point.end; ++at) {
      const Row& row = system_.rows()[at];
      for (int k = 0; k < row.size; ++k) {
        const int column = row.columns[static_cast<size_t>(k)];
        by_both.row(place_of[static_cast<size_t>(column)]) += row.by_camera.col(k).transpose() * row.by_point;
        for (int l = 0; l <= k; ++l) {
          const int other = row.columns[static_cast<size_t>(l)];
          sum.matrix(std::max(column, other), std::min(column, other)) +=
              row.by_camera.col(k).dot(row.by_camera.col(l));
        }
      }
    }
    times_inverse.noalias() = by_both * inverses_[p];
    const bool is_long = columns.size() >= kManyColumns;
    for (size_t k = 0; k < columns.size(); ++k) {
      const auto at = static_cast<Eigen::Index>(k);
      sum.right(columns[k]) += times_inverse.row(at).dot(point.gradient);
      for (size_t l = 0; l <= k && !is_long; ++l) {
        sum.matrix(std::max(columns[k], columns[l]), std::min(columns[k], columns[l])) -=
            times_inverse.row(at).dot(by_both.row(static_cast<Eigen::Index>(l)));
      }
    }
    if (is_long) SubtractPoint(columns, times_inverse, by_both, &sum.matrix);
    for (const int column : columns) place_of[static_cast<size_t>(column)] = -1;
  }
}

// Into the first; in their order, however many threads there are.
void Solver::SumComplements() {
  MatrixXd& matrix = complements_[0].matrix;
  ParallelFor(matrix.cols(), num_threads_, kColumnsAtOnce, [&](int64_t j) {
    const Eigen::Index below = matrix.rows() - j;
    for (size_t part = 1; part < complements_.size(); ++part)
      matrix.col(j).tail(below) += complements_[part].matrix.col(j).tail(below);
  });
}

bool Solver::FindStep(double radius) {
  system_.ForParts([&](size_t part) { EliminatePart(part, radius); });
  MatrixXd& matrix = complements_[0].matrix;
  VectorXd right = complements_[0].right - system_.gradient();
  for (size_t part = 1; part < complements_.size(); ++part) right += complements_[part].right;
  SumComplements();
  for (const PriorRow& row : system_.prior_rows()) {
    for (const auto& [a, by_a] : row.columns) {
      for (const auto& [b, by_b] : row.columns) {
        if (b <= a) matrix(a, b) += by_a * by_b;
      }
    }
  }
  for (Eigen::Index j = 0; j < matrix.rows(); ++j) matrix(j, j) += Damping(system_.squares()(j), radius);
  const Eigen::LLT<MatrixXd, Eigen::Lower> factor(matrix);
  if (factor.info() != Eigen::Success) return false;
  step_ = factor.solve(right);
  if (!step_.allFinite()) return false;
  system_.ForParts([&](size_t part) {
    for (size_t p = system_.PartBegin(part); p < system_.PartEnd(part); ++p) {
      const LinearisedSystem::Point& point = system_.points()[p];
      Vector3d rest = -point.gradient;
      for (size_t at = point.begin; at < point.end; ++at) {
        const Row& row = system_.rows()[at];
        Vector2d moved = Vector2d::Zero();
        for (int k = 0; k < row.size; ++k)
          moved += row.by_camera.col(k) * step_(row.columns[static_cast<size_t>(k)]);
        rest -= row.by_point.transpose() * moved;
      }
      point_steps_[p] = inverses_[p] * rest;
    }
  });
  return true;
}

// By how much the linearised cost falls.
double Solver::ModelDecrease() {
  double decrease = system_.SumParts([&](size_t part) {
    double sum = 0;
    for (size_t p = system_.PartBegin(part); p < system_.PartEnd(part); ++p) {
      for (size_t at = system_.points()[p].begin; at < system_.points()[p].end; ++at) {
        const Row& row = system_.rows()[at];
        Vector2d moved = row.by_point * point_steps_[p];
        for (int k = 0; k < row.size; ++k)
          moved += row.by_camera.col(k) * step_(row.columns[static_cast<size_t>(k)]);
        sum -= moved.dot(row.residual + 0.5 * moved);
      }
    }
    return sum;
  });
  for (const PriorRow& row : system_.prior_rows()) {
    double moved = 0;
    for (const auto& [column, derivative] : row.columns) moved += derivative * step_(column);
    decrease -= moved * (row.residual + 0.5 * moved);
  }
  return decrease;
}

DenseSchurSummary Solver::Solve(const DenseSchurOptions& options, Reporter& reporter) {
  DenseSchurSummary summary;
  summary.cost = system_.Cost();
  system_.Linearise();
  double radius = kFirstRadius, shrink = 2;
  int num_invalid = 0;
  summary.converged = system_.GradientNorm() <= kGradientTolerance;
  while (!summary.converged && summary.iterations < options.max_iterations && radius > kMinRadius) {
    reporter.Progress("joint adjustment", summary.iterations, options.max_iterations);
    if (reporter.StopRequested()) throw Interrupted();
    ++summary.iterations;
    const double predicted = FindStep(radius) ? ModelDecrease() : -1;
    if (!(predicted > 0)) {
      if (++num_invalid >= kMaxInvalidSteps) break;
      radius /= shrink;
      shrink *= 2;
      continue;
    }
    num_invalid = 0;
    system_.Keep();
    const auto [step, length] = system_.MoveBy(step_, point_steps_);
    const double cost = system_.Cost();
    const double decrease = summary.cost - cost;
    summary.converged = step <= kParameterTolerance * (length + kParameterTolerance) ||
                        std::abs(decrease) <= options.function_tolerance * summary.cost;
    const double ratio = decrease / predicted;
    if (!(ratio > kMinRelativeDecrease)) {  // a cost that is no number, too
      system_.GoBack();
      radius /= shrink;
      shrink *= 2;
      continue;
    }
    summary.cost = cost;
    if (summary.converged) break;
    radius = std::min(kMaxRadius, radius / std::max(1.0 / 3, 1 - std::pow(2 * ratio - 1, 3)));
    shrink = 2;
    system_.Linearise();
    summary.converged = system_.GradientNorm() <= kGradientTolerance;
  }
  reporter.Progress("joint adjustment", options.max_iterations, options.max_iterations);
  return summary;
}

}  // namespace

DenseSchurSummary SolveDenseSchur(const JointSystem& system, const ceres::LossFunction* loss,
                                  const DenseSchurOptions& options, Reporter& reporter) {
  return Solver(system, loss, options).Solve(options, reporter);
}

}  // namespace s2gs
