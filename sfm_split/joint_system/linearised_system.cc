#include "sfm_split/joint_system/linearised_system.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <unordered_map>
#include <utility>
#include <vector>

#include "sfm_split/base/error.h"

namespace s2gs {

using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::VectorXd;

LinearisedSystem::LinearisedSystem(const JointSystem& system, const ceres::LossFunction* loss,
                                   int num_threads)
    : system_(system), loss_(loss), num_threads_(num_threads) {
  ListColumns();
  SortByPoint();
}

void LinearisedSystem::ListColumns() {
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
}

void LinearisedSystem::SortByPoint() {
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

  rows_.resize(terms_.size());
  for (size_t at = 0; at < terms_.size(); ++at) {
    const JointSystem::Term& term = terms[terms_[at]];
    int count = 0;
    for (int b = 0; b < term.num_blocks; ++b) {
      for (const int column : column_of_[static_cast<size_t>(term.blocks[static_cast<size_t>(b)])]) {
        if (column < 0) continue;
        S2GS_INVARIANT(count < kMaxColumns);
        rows_[at].columns[static_cast<size_t>(count++)] = column;
      }
    }
    rows_[at].size = count;
  }
}

void LinearisedSystem::EvaluatePrior(const PriorTerm& prior, PriorRow* row) const {
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

double LinearisedSystem::Cost() const {
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

void LinearisedSystem::LineariseTerm(size_t at) {
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

void LinearisedSystem::Linearise() {
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
void LinearisedSystem::ScaleColumns() {
  for (size_t j = 0; j < columns_.size(); ++j) {
    columns_[j].scale = 1 / (1 + std::sqrt(squares_(static_cast<Eigen::Index>(j))));
  }
  ForParts([&](size_t part) {
    for (size_t p = part_begin_[part]; p < part_begin_[part + 1]; ++p) {
      Point& point = points_[p];
      point.scale = (1 + point.squares.array().sqrt()).inverse();
      for (size_t at = point.begin; at < point.end; ++at) {
        rows_[at].by_point *= point.scale.asDiagonal();
        for (int k = 0; k < rows_[at].size; ++k) {
          rows_[at].by_camera.col(k) *=
              columns_[static_cast<size_t>(rows_[at].columns[static_cast<size_t>(k)])].scale;
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
void LinearisedSystem::SumColumns() {
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
        for (int k = 0; k < rows_[at].size; ++k) {
          const int column = rows_[at].columns[static_cast<size_t>(k)];
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

double LinearisedSystem::GradientNorm() const {
  double norm = 0;
  for (size_t j = 0; j < columns_.size(); ++j) {
    norm = std::max(norm, std::abs(gradient_(static_cast<Eigen::Index>(j))) / columns_[j].scale);
  }
  for (const Point& point : points_) {
    norm = std::max(norm, point.gradient.cwiseQuotient(point.scale).cwiseAbs().maxCoeff());
  }
  return norm;
}

std::pair<double, double> LinearisedSystem::MoveBy(const VectorXd& step,
                                                   const std::vector<Vector3d>& point_steps) {
  double step2 = 0, length2 = 0;
  for (size_t j = 0; j < columns_.size(); ++j) {
    const double move = step(static_cast<Eigen::Index>(j)) * columns_[j].scale;
    length2 += *columns_[j].value * *columns_[j].value;
    step2 += move * move;
    *columns_[j].value += move;
  }
  for (size_t p = 0; p < points_.size(); ++p) {
    Eigen::Map<Vector3d> x(points_[p].values);
    const Vector3d move = point_steps[p].cwiseProduct(points_[p].scale);
    length2 += x.squaredNorm();
    step2 += move.squaredNorm();
    x += move;
  }
  return {std::sqrt(step2), std::sqrt(length2)};
}

void LinearisedSystem::Keep() {
  kept_columns_.clear();
  kept_columns_.reserve(columns_.size());
  kept_points_.clear();
  kept_points_.reserve(points_.size());
  for (const Place& column : columns_) kept_columns_.push_back(*column.value);
  for (const Point& point : points_) kept_points_.emplace_back(Eigen::Map<const Vector3d>(point.values));
}

void LinearisedSystem::GoBack() {
  for (size_t j = 0; j < columns_.size(); ++j) *columns_[j].value = kept_columns_[j];
  for (size_t p = 0; p < points_.size(); ++p) Eigen::Map<Vector3d>(points_[p].values) = kept_points_[p];
}

}  // namespace s2gs
