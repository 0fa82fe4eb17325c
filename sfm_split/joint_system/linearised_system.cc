#include "sfm_split/joint_system/linearised_system.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <utility>
#include <vector>

#include "sfm_split/base/error.h"

namespace s2gs {

using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::VectorXd;

LinearisedSystem::LinearisedSystem(const JointSystem& system, const ceres::LossFunction* loss,
                                   int num_threads)
    : system_(system), loss_(loss), num_threads_(num_threads) {
  ListColumns();
  SortByPoint();
  ListSights();
  first_place_.resize(terms_.size());
  ForParts([&](size_t part) { ListColumnsOfPoints(part); });
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
  square_.resize(count, count);
  gradient_.resize(count);
}

// The object's first.
void LinearisedSystem::SortByPoint() {
  const std::vector<JointSystem::Term>& terms = system_.terms();
  size_t num_object = 0, num_background = 0;
  for (const JointSystem::Term& term : terms) {
    size_t& num = term.of_object ? num_object : num_background;
    num = std::max(num, static_cast<size_t>(term.point) + 1);
  }
  const auto number_of = [&](const JointSystem::Term& term) {
    return static_cast<size_t>(term.point) + (term.of_object ? 0 : num_object);
  };
  std::vector<size_t> next(num_object + num_background + 1, 0);  // place in terms_
  for (const JointSystem::Term& term : terms) ++next[number_of(term) + 1];
  for (size_t p = 1; p < next.size(); ++p) {
    if (next[p] > 0) points_.push_back({nullptr, next[p - 1], next[p - 1] + next[p]});
    next[p] += next[p - 1];
  }
  terms_.resize(terms.size());
  for (size_t t = 0; t < terms.size(); ++t) terms_[next[number_of(terms[t])]++] = t;
  for (Point& point : points_) {
    const JointSystem::Term& term = terms[terms_[point.begin]];
    point.values = term.values[static_cast<size_t>(term.num_blocks)];
  }
  // Parts of equal numbers of observations.
  size_t p = 0;
  for (size_t part = 0; part < kParts; ++part) {
    part_begin_[part] = p;
    while (p < points_.size() && points_[p].end * kParts <= terms_.size() * (part + 1)) ++p;
  }
  part_begin_[kParts] = points_.size();
}

void LinearisedSystem::ListSights() {
  const std::vector<JointSystem::Term>& terms = system_.terms();
  std::vector<int> sight_of;  // by photo and body
  size_t num_sums = 0;
  sight_of_.reserve(terms_.size());
  for (const size_t t : terms_) {
    const JointSystem::Term& term = terms[t];
    const size_t seen = 2 * static_cast<size_t>(term.image) + (term.of_object ? 1 : 0);
    if (sight_of.size() <= seen) sight_of.resize(seen + 1, -1);
    const bool is_new = sight_of[seen] < 0;
    if (is_new) sight_of[seen] = static_cast<int>(sights_.size());
    sight_of_.push_back(sight_of[seen]);
    if (!is_new) continue;
    Sight& sight = sights_.emplace_back();
    sight.term = t;
    for (int b = 0; b < term.num_blocks; ++b) {
      const std::vector<int>& columns = column_of_[static_cast<size_t>(term.blocks[static_cast<size_t>(b)])];
      for (size_t value = 0; value < columns.size(); ++value) {
        if (columns[value] < 0) continue;
        S2GS_INVARIANT(sight.size < kMaxColumns);
        const auto k = static_cast<size_t>(sight.size++);
        sight.columns[k] = columns[value];
        sight.values[k] = {b, static_cast<int>(value)};
      }
    }
    sight.first_sum = num_sums;
    num_sums += static_cast<size_t>(sight.NumSums());
  }
  for (Part& part : parts_) part.sums.resize(num_sums);
}

void LinearisedSystem::ListColumnsOfPoints(size_t part) {
  Part& of = parts_[part];
  std::vector<int> place_of(columns_.size(), -1);
  for (size_t p = part_begin_[part]; p < part_begin_[part + 1]; ++p) {
    Point& point = points_[p];
    const auto first = static_cast<std::ptrdiff_t>(of.columns.size());
    for (size_t at = point.begin; at < point.end; ++at) {
      const Sight& sight = sights_[static_cast<size_t>(sight_of_[at])];
      for (size_t k = 0; k < static_cast<size_t>(sight.size); ++k) {
        int& place = place_of[static_cast<size_t>(sight.columns[k])];
        if (place >= 0) continue;
        place = 0;
        of.columns.push_back(sight.columns[k]);
      }
    }
    std::sort(of.columns.begin() + first, of.columns.end());
    point.num_columns = static_cast<int>(static_cast<std::ptrdiff_t>(of.columns.size()) - first);
    const int* const columns = of.columns.data() + first;
    for (int k = 0; k < point.num_columns; ++k) place_of[static_cast<size_t>(columns[k])] = k;
    for (size_t at = point.begin; at < point.end; ++at) {
      const Sight& sight = sights_[static_cast<size_t>(sight_of_[at])];
      first_place_[at] = of.places.size();
      for (size_t k = 0; k < static_cast<size_t>(sight.size); ++k)
        of.places.push_back(place_of[static_cast<size_t>(sight.columns[k])]);
    }
    for (int k = 0; k < point.num_columns; ++k) place_of[static_cast<size_t>(columns[k])] = -1;
  }
  of.by_both.resize(3 * of.columns.size());
  size_t next = 0;
  for (size_t p = part_begin_[part]; p < part_begin_[part + 1]; ++p) {
    points_[p].columns = of.columns.data() + next;
    points_[p].by_both = of.by_both.data() + 3 * next;
    next += static_cast<size_t>(points_[p].num_columns);
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
    if (column >= 0) row->columns.emplace_back(column, derivatives[k]);
  }
}

void LinearisedSystem::TakeFrames(bool with_derivatives) {
  for (Sight& sight : sights_) {
    const JointSystem::Term& term = system_.terms()[sight.term];
    sight.frame = term.cost.FrameAt(term.values.data(), with_derivatives);
  }
}

double LinearisedSystem::Cost() {
  TakeFrames(false);
  const std::vector<JointSystem::Term>& terms = system_.terms();
  double cost = SumParts([&](size_t part) {
    double sum = 0;
    for (size_t p = part_begin_[part]; p < part_begin_[part + 1]; ++p) {
      for (size_t at = points_[p].begin; at < points_[p].end; ++at) {
        const JointSystem::Term& term = terms[terms_[at]];
        Vector2d residual;
        term.cost.EvaluateIn(sights_[static_cast<size_t>(sight_of_[at])].frame, term.values.data(),
                             residual.data(), nullptr);
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

void LinearisedSystem::AddTerm(size_t at, Part* part, Point* point) {
  const JointSystem::Term& term = system_.terms()[terms_[at]];
  const Sight& sight = sights_[static_cast<size_t>(sight_of_[at])];
  std::array<std::array<double, 32>, 5> storage;
  std::array<double*, 5> jacobians{};
  for (int b = 0; b <= term.num_blocks; ++b)
    jacobians[static_cast<size_t>(b)] = storage[static_cast<size_t>(b)].data();
  Vector2d residual;
  term.cost.EvaluateIn(sight.frame, term.values.data(), residual.data(), jacobians.data());
  std::array<double, 3> rho = {0, 1, 0};
  if (loss_ != nullptr) loss_->Evaluate(residual.squaredNorm(), rho.data());
  // The losses there are grow ever slower, so that Triggs' correction is the weight alone.
  const double weight = std::sqrt(term.weight * rho[1]);
  residual *= weight;
  std::array<double, kMaxColumns> by_x, by_y;  // the residual's two coordinates
  for (int k = 0; k < sight.size; ++k) {
    const auto [block, value] = sight.values[static_cast<size_t>(k)];
    const double* const jacobian = storage[static_cast<size_t>(block)].data();
    const auto size = column_of_[static_cast<size_t>(term.blocks[static_cast<size_t>(block)])].size();
    by_x[static_cast<size_t>(k)] = weight * jacobian[value];
    by_y[static_cast<size_t>(k)] = weight * jacobian[size + static_cast<size_t>(value)];
  }
  double* to = part->sums.data() + sight.first_sum;
  for (int l = 0; l < sight.size; ++l) {
    const double x = by_x[static_cast<size_t>(l)], y = by_y[static_cast<size_t>(l)];
    for (int k = l; k < sight.size; ++k)
      *to++ += by_x[static_cast<size_t>(k)] * x + by_y[static_cast<size_t>(k)] * y;
  }
  for (size_t k = 0; k < static_cast<size_t>(sight.size); ++k)
    *to++ += by_x[k] * residual.x() + by_y[k] * residual.y();

  Eigen::Matrix<double, 2, 3> by_point;
  for (int i = 0; i < 2; ++i) {
    for (int j = 0; j < 3; ++j)
      by_point(i, j) = weight * storage[static_cast<size_t>(term.num_blocks)][static_cast<size_t>(3 * i + j)];
  }
  point->square += by_point.transpose() * by_point;
  point->gradient += by_point.transpose() * residual;
  const int* const place = part->places.data() + first_place_[at];
  for (int j = 0; j < 3; ++j) {
    double* const by_both = point->by_both + static_cast<std::ptrdiff_t>(j) * point->num_columns;
    const double x = by_point(0, j), y = by_point(1, j);
    for (size_t k = 0; k < static_cast<size_t>(sight.size); ++k)
      by_both[place[k]] += by_x[k] * x + by_y[k] * y;
  }
}

// What was not scaled by this yet.
void LinearisedSystem::ScalePoint(const Vector3d& scale, Point* point) {
  point->gradient = point->gradient.cwiseProduct(scale);
  point->square = (scale.asDiagonal() * point->square * scale.asDiagonal()).eval();
  for (int j = 0; j < 3; ++j) {
    double* const by_both = point->by_both + static_cast<std::ptrdiff_t>(j) * point->num_columns;
    for (int k = 0; k < point->num_columns; ++k)
      by_both[k] *= columns_[static_cast<size_t>(point->columns[k])].scale * scale(j);
  }
}

void LinearisedSystem::LinearisePart(size_t part) {
  std::vector<double>& sums = parts_[part].sums;
  std::fill(sums.begin(), sums.end(), 0);
  for (size_t p = part_begin_[part]; p < part_begin_[part + 1]; ++p) {
    Point& point = points_[p];
    point.gradient.setZero();
    point.square.setZero();
    std::fill_n(point.by_both, 3 * point.num_columns, 0);
    for (size_t at = point.begin; at < point.end; ++at) AddTerm(at, &parts_[part], &point);
    if (is_scaled_) ScalePoint(point.scale, &point);
  }
}

// Over the parts, in their order, and over the sights.
void LinearisedSystem::SumSights() {
  std::vector<double>& sums = parts_[0].sums;
  for (size_t part = 1; part < kParts; ++part) {
    const std::vector<double>& more = parts_[part].sums;
    for (size_t k = 0; k < sums.size(); ++k) sums[k] += more[k];
  }
  square_.setZero();
  gradient_.setZero();
  for (const Sight& sight : sights_) {
    const double* from = sums.data() + sight.first_sum;
    for (int l = 0; l < sight.size; ++l) {
      const int column = sight.columns[static_cast<size_t>(l)];
      for (int k = l; k < sight.size; ++k) {
        const int other = sight.columns[static_cast<size_t>(k)];
        square_(std::max(column, other), std::min(column, other)) += *from++;
      }
    }
    for (int k = 0; k < sight.size; ++k) gradient_(sight.columns[static_cast<size_t>(k)]) += *from++;
  }
}

// Unscaled as the sums are.
void LinearisedSystem::AddPriors() {
  PriorRow row;
  for (const PriorTerm& prior : system_.priors()) {
    EvaluatePrior(prior, &row);
    for (const auto& [column, derivative] : row.columns) {
      gradient_(column) += derivative * row.residual;
      for (const auto& [other, by_other] : row.columns) {
        if (other <= column) square_(column, other) += derivative * by_other;
      }
    }
  }
}

void LinearisedSystem::Linearise() {
  TakeFrames(true);
  ForParts([&](size_t part) { LinearisePart(part); });
  SumSights();
  AddPriors();
  if (!is_scaled_) ScaleColumns();
  for (size_t j = 0; j < columns_.size(); ++j) {
    const auto column = static_cast<Eigen::Index>(j);
    gradient_(column) *= columns_[j].scale;
    for (size_t i = j; i < columns_.size(); ++i)
      square_(static_cast<Eigen::Index>(i), column) *= columns_[i].scale * columns_[j].scale;
  }
}

// Of length about 1, by the derivatives at the start.
void LinearisedSystem::ScaleColumns() {
  for (size_t j = 0; j < columns_.size(); ++j) {
    const auto column = static_cast<Eigen::Index>(j);
    columns_[j].scale = 1 / (1 + std::sqrt(square_(column, column)));
  }
  ForParts([&](size_t part) {
    for (size_t p = part_begin_[part]; p < part_begin_[part + 1]; ++p) {
      Point& point = points_[p];
      point.scale = (1 + point.square.diagonal().array().sqrt()).inverse();
      ScalePoint(point.scale, &point);
    }
  });
  is_scaled_ = true;
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
