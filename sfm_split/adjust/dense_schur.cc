#include "sfm_split/adjust/dense_schur.h"

#include <Eigen/Cholesky>
#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <unordered_map>
#include <utility>
#include <vector>

#include "sfm_split/base/error.h"
#include "sfm_split/base/parallel_for.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::VectorXd;
using PointRows = Eigen::Matrix<double, Eigen::Dynamic, 3>;  // of columns, by the point's coordinates

// Parts of the points, each with a matrix of its own: as many threads at most can work.
constexpr int kParts = 16;
// A pass over so many observations takes about a millisecond, far longer than to wake a thread and wait for
// it.
constexpr size_t kTermsOfAThread = 1000;
// Of a point's columns, from where on the matrix' memory is what its elimination waits for: cameras that are
// free.
constexpr size_t kManyColumns = 100;
// Of a matrix' columns, which a thread sums over the parts: some 100 us where there are 600.
constexpr int kColumnsAtOnce = 64;
// Two poses and COLMAP's largest camera model.
constexpr int kMaxColumns = 6 + 6 + 12;

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

// An observation, linearised: residual and derivatives with the loss' weight, columns scaled.
struct Row {
  Vector2d residual;
  Eigen::Matrix<double, 2, 3> by_point;
  Eigen::Matrix<double, 2, kMaxColumns> by_camera;
};

struct Place {
  double* value;
  double scale = 1;  // of the column.
};

class Solver {
 public:
  Solver(const JointSystem& system, const ceres::LossFunction* loss, const DenseSchurOptions& options)
      : system_(system), loss_(loss) {
    const int asked = NumThreadsOf(options.num_threads);
    num_threads_ = static_cast<int>(
        std::clamp<size_t>(system.terms().size() / kTermsOfAThread, 1, static_cast<size_t>(asked)));
    ListColumns();
    SortByPoint();
    rows_.resize(system.terms().size());
    inverses_.resize(points_.size());
    complements_.resize(kParts);
  }

  DenseSchurSummary Solve(const DenseSchurOptions& options, Reporter& reporter);

 private:
  struct Point {
    double* values;
    size_t begin, end;  // in terms_.
    Vector3d scale = Vector3d::Ones();
    Vector3d gradient = Vector3d::Zero();
    Vector3d squares = Vector3d::Zero();  // of its columns.
    Vector3d step = Vector3d::Zero();     // scaled.
  };
  struct Complement {
    MatrixXd matrix;  // lower triangle.
    VectorXd right;
  };
  struct PriorRow {
    double residual = 0;
    std::vector<std::pair<int, double>> columns;  // scaled derivatives.
  };

  void ListColumns();
  void SortByPoint();
  // Calls work(part) for all parts.
  template <typename Work>
  void ForParts(const Work& work) {
    ParallelFor(kParts, num_threads_, [&](int64_t part) { work(static_cast<size_t>(part)); });
  }
  // Sums work(part) over the parts, in their order.
  template <typename Work>
  double SumParts(const Work& work) {
    std::array<double, kParts> sums{};
    ForParts([&](size_t part) { sums[part] = work(part); });
    double sum = 0;
    for (const double one : sums) sum += one;
    return sum;
  }
  void EvaluatePrior(const PriorTerm& prior, PriorRow* row) const;
  double Cost();
  void Linearise();
  void LineariseTerm(size_t at);
  void ScaleColumns();
  void SumColumns();
  // Damped by the radius. False when the matrix is not positive definite.
  bool FindStep(double radius);
  void EliminatePart(size_t part, double radius);
  static void SubtractPoint(const std::vector<int>& columns, const PointRows& times_inverse,
                            const PointRows& by_both, MatrixXd* sum);
  void SumComplements();
  double ModelDecrease();
  double GradientNorm() const;
  // x + step; returns the length of the step and of x.
  std::pair<double, double> MoveByStep();
  void Keep();
  void GoBack();

  const JointSystem& system_;
  const ceres::LossFunction* loss_;
  int num_threads_ = 1;
  std::vector<Place> columns_;
  std::vector<std::vector<int>> column_of_;  // by block and value; -1: held.
  std::vector<size_t> terms_;                // by point.
  std::vector<Point> points_;
  std::array<size_t, kParts + 1> part_begin_{};  // in points_.
  std::vector<Row> rows_;                        // in the order of terms_.
  std::vector<std::array<int, kMaxColumns>> row_columns_;
  std::vector<int> row_sizes_;
  std::vector<PriorRow> prior_rows_;
  VectorXd gradient_, squares_, step_;
  std::vector<Matrix3d> inverses_;  // of the points' damped blocks.
  std::vector<Complement> complements_;
  std::vector<double> kept_columns_;
  std::vector<Vector3d> kept_points_;
  bool is_scaled_ = false;
};

void Solver::ListColumns() {
  for (const JointSystem::Block& block : system_.blocks()) {
    std::vector<int> places(static_cast<size_t>(block.size), -1);
    if (block.used) {
      for (const int value : block.free) {
        places[static_cast<size_t>(value)] = static_cast<int>(columns_.size());
        columns_.push_back({block.values + value});
      }
    }
    column_of_.push_back(std::move(places));
  }
  const auto count = static_cast<Eigen::Index>(columns_.size());
  gradient_.resize(count);
  squares_.resize(count);
  step_.setZero(count);
}

void Solver::SortByPoint() {
  const std::vector<JointSystem::Term>& terms = system_.terms();
  std::unordered_map<const double*, size_t> point_of;
  std::vector<std::vector<size_t>> terms_of;
  for (size_t t = 0; t < terms.size(); ++t) {
    double* const values = terms[t].values[static_cast<size_t>(terms[t].num_blocks)];
    const auto [found, is_new] = point_of.try_emplace(values, points_.size());
    if (is_new) {
      points_.push_back({values, 0, 0});
      terms_of.emplace_back();
    }
    terms_of[found->second].push_back(t);
  }
  terms_.reserve(terms.size());
  for (size_t p = 0; p < points_.size(); ++p) {
    points_[p].begin = terms_.size();
    terms_.insert(terms_.end(), terms_of[p].begin(), terms_of[p].end());
    points_[p].end = terms_.size();
  }
  // Parts of equal numbers of observations.
  size_t p = 0;
  for (size_t part = 0; part < kParts; ++part) {
    part_begin_[part] = p;
    while (p < points_.size() && points_[p].end * kParts <= terms_.size() * (part + 1)) ++p;
  }
  part_begin_[kParts] = points_.size();

  row_columns_.resize(terms_.size());
  row_sizes_.resize(terms_.size());
  for (size_t at = 0; at < terms_.size(); ++at) {
    const JointSystem::Term& term = terms[terms_[at]];
    int count = 0;
    for (int b = 0; b < term.num_blocks; ++b) {
      for (const int column : column_of_[static_cast<size_t>(term.blocks[static_cast<size_t>(b)])]) {
        if (column < 0) continue;
        S2GS_INVARIANT(count < kMaxColumns);
        row_columns_[at][static_cast<size_t>(count++)] = column;
      }
    }
    row_sizes_[at] = count;
  }
}

void Solver::EvaluatePrior(const PriorTerm& prior, PriorRow* row) const {
  std::vector<double> values;
  values.reserve(prior.parts.size());
  for (const PriorTerm::Part& part : prior.parts) {
    values.push_back(system_.blocks()[static_cast<size_t>(part.block)].values[part.value]);
  }
  std::vector<double> derivatives;
  row->residual = prior.Residual(values, &derivatives);
  row->columns.clear();
  for (size_t k = 0; k < prior.parts.size(); ++k) {
    const PriorTerm::Part& part = prior.parts[k];
    const int column = column_of_[static_cast<size_t>(part.block)][static_cast<size_t>(part.value)];
    if (column >= 0) {
      row->columns.emplace_back(column, derivatives[k] * columns_[static_cast<size_t>(column)].scale);
    }
  }
}

double Solver::Cost() {
  const std::vector<JointSystem::Term>& terms = system_.terms();
  double cost = SumParts([&](size_t part) {
    double sum = 0;
    for (size_t p = part_begin_[part]; p < part_begin_[part + 1]; ++p) {
      for (size_t at = points_[p].begin; at < points_[p].end; ++at) {
        const JointSystem::Term& term = terms[terms_[at]];
        Vector2d residual;
        term.cost->Evaluate(term.values.data(), residual.data(), nullptr);
        std::array<double, 3> rho = {residual.squaredNorm(), 1, 0};
        if (loss_ != nullptr) loss_->Evaluate(residual.squaredNorm(), rho.data());
        sum += 0.5 * term.weight * rho[0];
      }
    }
    return sum;
  });
  PriorRow row;
  for (const PriorTerm& prior : system_.priors()) {
    EvaluatePrior(prior, &row);
    cost += 0.5 * row.residual * row.residual;
  }
  return cost;
}

void Solver::LineariseTerm(size_t at) {
  const JointSystem::Term& term = system_.terms()[terms_[at]];
  Row& row = rows_[at];
  std::array<std::array<double, 32>, 5> storage;
  std::array<double*, 5> jacobians{};
  for (int b = 0; b <= term.num_blocks; ++b)
    jacobians[static_cast<size_t>(b)] = storage[static_cast<size_t>(b)].data();
  term.cost->Evaluate(term.values.data(), row.residual.data(), jacobians.data());
  std::array<double, 3> rho = {0, 1, 0};
  if (loss_ != nullptr) loss_->Evaluate(row.residual.squaredNorm(), rho.data());
  // The losses there are grow ever slower, so that Triggs' correction is the weight alone.
  const double weight = std::sqrt(term.weight * rho[1]);
  row.residual *= weight;
  int k = 0;
  for (int b = 0; b < term.num_blocks; ++b) {
    const std::vector<int>& places = column_of_[static_cast<size_t>(term.blocks[static_cast<size_t>(b)])];
    const double* jacobian = jacobians[static_cast<size_t>(b)];
    for (size_t value = 0; value < places.size(); ++value) {
      if (places[value] < 0) continue;
      const double scale = weight * columns_[static_cast<size_t>(places[value])].scale;
      row.by_camera(0, k) = scale * jacobian[value];
      row.by_camera(1, k) = scale * jacobian[places.size() + value];
      ++k;
    }
  }
  const double* by_point = jacobians[static_cast<size_t>(term.num_blocks)];
  for (int i = 0; i < 2; ++i) {
    for (int j = 0; j < 3; ++j) row.by_point(i, j) = weight * by_point[3 * i + j];
  }
}

void Solver::Linearise() {
  ForParts([&](size_t part) {
    for (size_t p = part_begin_[part]; p < part_begin_[part + 1]; ++p) {
      for (size_t at = points_[p].begin; at < points_[p].end; ++at) {
        LineariseTerm(at);
        if (is_scaled_) rows_[at].by_point *= points_[p].scale.asDiagonal();
      }
    }
  });
  prior_rows_.resize(system_.priors().size());
  for (size_t k = 0; k < prior_rows_.size(); ++k) EvaluatePrior(system_.priors()[k], &prior_rows_[k]);
  SumColumns();
  if (is_scaled_) return;
  ScaleColumns();
  SumColumns();
}

// Of length about 1, by the derivatives at the start.
void Solver::ScaleColumns() {
  for (size_t j = 0; j < columns_.size(); ++j) {
    columns_[j].scale = 1 / (1 + std::sqrt(squares_(static_cast<Eigen::Index>(j))));
  }
  ForParts([&](size_t part) {
    for (size_t p = part_begin_[part]; p < part_begin_[part + 1]; ++p) {
      Point& point = points_[p];
      point.scale = (1 + point.squares.array().sqrt()).inverse();
      for (size_t at = point.begin; at < point.end; ++at) {
        rows_[at].by_point *= point.scale.asDiagonal();
        for (int k = 0; k < row_sizes_[at]; ++k) {
          rows_[at].by_camera.col(k) *=
              columns_[static_cast<size_t>(row_columns_[at][static_cast<size_t>(k)])].scale;
        }
      }
    }
  });
  for (PriorRow& row : prior_rows_) {
    for (auto& [column, derivative] : row.columns) derivative *= columns_[static_cast<size_t>(column)].scale;
  }
  is_scaled_ = true;
}

// The gradient, and the squares of the columns' lengths.
void Solver::SumColumns() {
  std::array<VectorXd, kParts> gradients, squares;
  ForParts([&](size_t part) {
    gradients[part].setZero(gradient_.size());
    squares[part].setZero(gradient_.size());
    for (size_t p = part_begin_[part]; p < part_begin_[part + 1]; ++p) {
      Point& point = points_[p];
      point.gradient.setZero();
      point.squares.setZero();
      for (size_t at = point.begin; at < point.end; ++at) {
        const Row& row = rows_[at];
        point.gradient += row.by_point.transpose() * row.residual;
        point.squares += row.by_point.colwise().squaredNorm().transpose();
        for (int k = 0; k < row_sizes_[at]; ++k) {
          const int column = row_columns_[at][static_cast<size_t>(k)];
          gradients[part](column) += row.by_camera.col(k).dot(row.residual);
          squares[part](column) += row.by_camera.col(k).squaredNorm();
        }
      }
    }
  });
  gradient_.setZero();
  squares_.setZero();
  for (size_t part = 0; part < kParts; ++part) {
    gradient_ += gradients[part];
    squares_ += squares[part];
  }
  for (const PriorRow& row : prior_rows_) {
    for (const auto& [column, derivative] : row.columns) {
      gradient_(column) += derivative * row.residual;
      squares_(column) += derivative * derivative;
    }
  }
}

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
  sum.matrix.setZero(gradient_.size(), gradient_.size());
  sum.right.setZero(gradient_.size());
  std::vector<int> columns;
  std::vector<int> place_of(columns_.size(), -1);
  PointRows by_both, times_inverse;
  for (size_t p = part_begin_[part]; p < part_begin_[part + 1]; ++p) {
    Point& point = points_[p];
    Matrix3d block = Matrix3d::Zero();
    columns.clear();
    for (size_t at = point.begin; at < point.end; ++at) {
      const Row& row = rows_[at];
      block += row.by_point.transpose() * row.by_point;
      for (int k = 0; k < row_sizes_[at]; ++k) {
        const int column = row_columns_[at][static_cast<size_t>(k)];
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
      const Row& row = rows_[at];
      for (int k = 0; k < row_sizes_[at]; ++k) {
        const int column = row_columns_[at][static_cast<size_t>(k)];
        by_both.row(place_of[static_cast<size_t>(column)]) += row.by_camera.col(k).transpose() * row.by_point;
        for (int l = 0; l <= k; ++l) {
          const int other = row_columns_[at][static_cast<size_t>(l)];
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
    for (size_t part = 1; part < kParts; ++part)
      matrix.col(j).tail(below) += complements_[part].matrix.col(j).tail(below);
  });
}

bool Solver::FindStep(double radius) {
  ForParts([&](size_t part) { EliminatePart(part, radius); });
  MatrixXd& matrix = complements_[0].matrix;
  VectorXd right = complements_[0].right - gradient_;
  for (size_t part = 1; part < kParts; ++part) right += complements_[part].right;
  SumComplements();
  for (const PriorRow& row : prior_rows_) {
    for (const auto& [a, by_a] : row.columns) {
      for (const auto& [b, by_b] : row.columns) {
        if (b <= a) matrix(a, b) += by_a * by_b;
      }
    }
  }
  for (Eigen::Index j = 0; j < matrix.rows(); ++j) matrix(j, j) += Damping(squares_(j), radius);
  const Eigen::LLT<MatrixXd, Eigen::Lower> factor(matrix);
  if (factor.info() != Eigen::Success) return false;
  step_ = factor.solve(right);
  if (!step_.allFinite()) return false;
  ForParts([&](size_t part) {
    for (size_t p = part_begin_[part]; p < part_begin_[part + 1]; ++p) {
      Point& point = points_[p];
      Vector3d rest = -point.gradient;
      for (size_t at = point.begin; at < point.end; ++at) {
        Vector2d moved = Vector2d::Zero();
        for (int k = 0; k < row_sizes_[at]; ++k)
          moved += rows_[at].by_camera.col(k) * step_(row_columns_[at][static_cast<size_t>(k)]);
        rest -= rows_[at].by_point.transpose() * moved;
      }
      point.step = inverses_[p] * rest;
    }
  });
  return true;
}

// By how much the linearised cost falls.
double Solver::ModelDecrease() {
  double decrease = SumParts([&](size_t part) {
    double sum = 0;
    for (size_t p = part_begin_[part]; p < part_begin_[part + 1]; ++p) {
      for (size_t at = points_[p].begin; at < points_[p].end; ++at) {
        Vector2d moved = rows_[at].by_point * points_[p].step;
        for (int k = 0; k < row_sizes_[at]; ++k)
          moved += rows_[at].by_camera.col(k) * step_(row_columns_[at][static_cast<size_t>(k)]);
        sum -= moved.dot(rows_[at].residual + 0.5 * moved);
      }
    }
    return sum;
  });
  for (const PriorRow& row : prior_rows_) {
    double moved = 0;
    for (const auto& [column, derivative] : row.columns) moved += derivative * step_(column);
    decrease -= moved * (row.residual + 0.5 * moved);
  }
  return decrease;
}

double Solver::GradientNorm() const {
  double norm = 0;
  for (size_t j = 0; j < columns_.size(); ++j) {
    norm = std::max(norm, std::abs(gradient_(static_cast<Eigen::Index>(j))) / columns_[j].scale);
  }
  for (const Point& point : points_) {
    norm = std::max(norm, point.gradient.cwiseQuotient(point.scale).cwiseAbs().maxCoeff());
  }
  return norm;
}

std::pair<double, double> Solver::MoveByStep() {
  double step2 = 0, length2 = 0;
  for (size_t j = 0; j < columns_.size(); ++j) {
    const double move = step_(static_cast<Eigen::Index>(j)) * columns_[j].scale;
    length2 += *columns_[j].value * *columns_[j].value;
    step2 += move * move;
    *columns_[j].value += move;
  }
  for (const Point& point : points_) {
    Eigen::Map<Vector3d> x(point.values);
    const Vector3d move = point.step.cwiseProduct(point.scale);
    length2 += x.squaredNorm();
    step2 += move.squaredNorm();
    x += move;
  }
  return {std::sqrt(step2), std::sqrt(length2)};
}

void Solver::Keep() {
  kept_columns_.clear();
  kept_columns_.reserve(columns_.size());
  kept_points_.clear();
  kept_points_.reserve(points_.size());
  for (const Place& column : columns_) kept_columns_.push_back(*column.value);
  for (const Point& point : points_) kept_points_.emplace_back(Eigen::Map<const Vector3d>(point.values));
}

void Solver::GoBack() {
  for (size_t j = 0; j < columns_.size(); ++j) *columns_[j].value = kept_columns_[j];
  for (size_t p = 0; p < points_.size(); ++p) Eigen::Map<Vector3d>(points_[p].values) = kept_points_[p];
}

DenseSchurSummary Solver::Solve(const DenseSchurOptions& options, Reporter& reporter) {
  DenseSchurSummary summary;
  summary.cost = Cost();
  Linearise();
  double radius = kFirstRadius, shrink = 2;
  int num_invalid = 0;
  summary.converged = GradientNorm() <= kGradientTolerance;
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
    Keep();
    const auto [step, length] = MoveByStep();
    const double cost = Cost();
    const double decrease = summary.cost - cost;
    summary.converged = step <= kParameterTolerance * (length + kParameterTolerance) ||
                        std::abs(decrease) <= options.function_tolerance * summary.cost;
    const double ratio = decrease / predicted;
    if (!(ratio > kMinRelativeDecrease)) {  // a cost that is no number, too
      GoBack();
      radius /= shrink;
      shrink *= 2;
      continue;
    }
    summary.cost = cost;
    if (summary.converged) break;
    radius = std::min(kMaxRadius, radius / std::max(1.0 / 3, 1 - std::pow(2 * ratio - 1, 3)));
    shrink = 2;
    Linearise();
    summary.converged = GradientNorm() <= kGradientTolerance;
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
