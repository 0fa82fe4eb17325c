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
using Eigen::Vector3d;
using Eigen::VectorXd;
using PointRows = LinearisedSystem::PointRows;

// A pass over so many observations takes about a millisecond, far longer than to wake a thread and wait for
// it.
constexpr size_t kTermsOfAThread = 1000;
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
  static void SubtractPoint(const int* columns, const PointRows& times_inverse,
                            const Eigen::Map<const PointRows>& by_both, std::vector<double>* products,
                            MatrixXd* sum);
  void SumComplements();
  double ModelDecrease(double radius);

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

// Twice what some unknowns' steps take from the linearised cost: s D s - g s.
template <typename Step, typename Gradient, typename Squares>
double TwiceDecrease(const Step& step, const Gradient& gradient, const Squares& squares, double radius) {
  double sum = 0;
  for (Eigen::Index k = 0; k < step.size(); ++k)
    sum += step(k) * (Damping(squares(k), radius) * step(k) - gradient(k));
  return sum;
}

// What eliminating a point takes from the cameras' matrix: each of its columns' rows times those of the
// columns before it.
void Solver::SubtractPoint(const int* columns, const PointRows& times_inverse,
                           const Eigen::Map<const PointRows>& by_both, std::vector<double>* products,
                           MatrixXd* sum) {
  const Eigen::Index count = by_both.rows();
  const double* const x = times_inverse.col(0).data();
  const double* const y = times_inverse.col(1).data();
  const double* const z = times_inverse.col(2).data();
  products->resize(static_cast<size_t>(count));
  double* const product = products->data();
  for (Eigen::Index l = 0; l < count; ++l) {
    const double by_x = by_both(l, 0), by_y = by_both(l, 1), by_z = by_both(l, 2);
    for (Eigen::Index k = l; k < count; ++k) product[k] = x[k] * by_x + (y[k] * by_y + z[k] * by_z);
    double* const to = sum->col(columns[l]).data();
    for (Eigen::Index k = l; k < count; ++k) to[columns[k]] -= product[k];
  }
}

void Solver::EliminatePart(size_t part, double radius) {
  Complement& sum = complements_[part];
  sum.matrix.setZero(system_.num_columns(), system_.num_columns());
  sum.right.setZero(system_.num_columns());
  PointRows times_inverse;
  std::vector<double> products;
  for (size_t p = system_.PartBegin(part); p < system_.PartEnd(part); ++p) {
    const LinearisedSystem::Point& point = system_.points()[p];
    Matrix3d block = point.square;
    for (int k = 0; k < 3; ++k) block(k, k) += Damping(point.square(k, k), radius);
    inverses_[p] = block.inverse();
    const int* const columns = point.columns;
    const Eigen::Map<const PointRows> by_both(point.by_both, point.num_columns, 3);
    times_inverse.noalias() = by_both * inverses_[p];
    for (Eigen::Index k = 0; k < by_both.rows(); ++k)
      sum.right(columns[k]) += times_inverse.row(k).dot(point.gradient);
    SubtractPoint(columns, times_inverse, by_both, &products, &sum.matrix);
  }
}

// Into the first; in their order, however many threads there are.
void Solver::SumComplements() {
  MatrixXd& matrix = complements_[0].matrix;
  ParallelFor(matrix.cols(), num_threads_, kColumnsAtOnce, [&](int64_t j) {
    const Eigen::Index below = matrix.rows() - j;
    matrix.col(j).tail(below) += system_.square().col(j).tail(below);
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
  for (Eigen::Index j = 0; j < matrix.rows(); ++j) matrix(j, j) += Damping(system_.square()(j, j), radius);
  const Eigen::LLT<MatrixXd, Eigen::Lower> factor(matrix);
  if (factor.info() != Eigen::Success) return false;
  step_ = factor.solve(right);
  if (!step_.allFinite()) return false;
  system_.ForParts([&](size_t part) {
    for (size_t p = system_.PartBegin(part); p < system_.PartEnd(part); ++p) {
      const LinearisedSystem::Point& point = system_.points()[p];
      const Eigen::Map<const PointRows> by_both(point.by_both, point.num_columns, 3);
      Vector3d rest = -point.gradient;
      for (Eigen::Index k = 0; k < by_both.rows(); ++k)
        rest -= by_both.row(k).transpose() * step_(point.columns[k]);
      point_steps_[p] = inverses_[p] * rest;
    }
  });
  return true;
}

// By how much the linearised cost falls: with (H + D) s = -g it is -g s - s H s / 2 = (s D s - g s) / 2.
double Solver::ModelDecrease(double radius) {
  double twice = TwiceDecrease(step_, system_.gradient(), system_.square().diagonal(), radius);
  twice += system_.SumParts([&](size_t part) {
    double sum = 0;
    for (size_t p = system_.PartBegin(part); p < system_.PartEnd(part); ++p) {
      const LinearisedSystem::Point& point = system_.points()[p];
      sum += TwiceDecrease(point_steps_[p], point.gradient, point.square.diagonal(), radius);
    }
    return sum;
  });
  return twice / 2;
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
    const double predicted = FindStep(radius) ? ModelDecrease(radius) : -1;
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
