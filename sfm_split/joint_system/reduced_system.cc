#include "sfm_split/joint_system/reduced_system.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <utility>

#include "sfm_split/joint_system/prepare_and_add.h"
#include "sfm_split/solvers/eigen_solvers.h"

namespace s2gs {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr int kCells = 12;        // of a photo, in each direction, in which errors may depend on each other
constexpr int kQuadrature = 400;  // quantiles of a Rayleigh-distributed error, at which a mean is taken
constexpr double kLeastCurvature = 0.1;  // of the robust cost, over that of squares
constexpr size_t kRings = 6;             // of the object about the axis, each with as many points

// What one point adds to the reduced system.
struct EliminatedPoint {
  PointScore score;
  VectorXd diagonal;
  MatrixXd square;
  int redundancy = 0;
  std::vector<LossSums> loss;  // of each observation
};

// The part of the photos of one camera in which a keypoint lies.
int CellOf(const JointProblem& problem, const JointSystem::Term& term) {
  const int camera = problem.images[static_cast<size_t>(term.image)].camera;
  const Camera& size = problem.cameras[static_cast<size_t>(camera)];
  const Eigen::Vector2d xy = term.cost.xy();
  const auto place = [](double x, double side) {
    return std::clamp(static_cast<int>(kCells * x / std::max(1.0, side)), 0, kCells - 1);
  };
  return (camera * kCells + place(xy.y(), static_cast<double>(size.height))) * kCells +
         place(xy.x(), static_cast<double>(size.width));
}

// Heights of the object's observed points along the axis at which one ring ends and the next begins.
std::vector<double> RingBounds(const JointProblem& problem) {
  std::vector<bool> is_seen(problem.object.points.size(), false);
  for (const JointObservation& observation : problem.object.observations) {
    if (observation.active) is_seen[static_cast<size_t>(observation.point)] = true;
  }
  std::vector<double> heights;
  for (size_t p = 0; p < is_seen.size(); ++p) {
    if (is_seen[p]) heights.push_back(problem.AxisDirection().dot(problem.object.points[p]));
  }
  std::sort(heights.begin(), heights.end());
  std::vector<double> bounds;
  for (size_t ring = 1; ring < kRings && !heights.empty(); ++ring)
    bounds.push_back(heights[ring * heights.size() / kRings]);
  return bounds;
}

EliminatedPoint EliminatePoint(const JointProblem& problem, const JointSystem& system,
                               const ceres::LossFunction* loss, const std::vector<double>& ring_bounds,
                               const std::vector<const JointSystem::Term*>& terms,
                               const std::vector<std::vector<int>>& column_of) {
  EliminatedPoint point;
  std::vector<int> touched;
  for (const JointSystem::Term* term : terms) {
    for (int b = 0; b < term->num_blocks; ++b) {
      for (const int column : column_of[term->blocks[b]]) {
        if (column >= 0) touched.push_back(column);
      }
    }
  }
  std::sort(touched.begin(), touched.end());
  touched.erase(std::unique(touched.begin(), touched.end()), touched.end());
  const auto rows = static_cast<Eigen::Index>(2 * terms.size());
  MatrixXd by_cameras = MatrixXd::Zero(rows, static_cast<Eigen::Index>(touched.size()));
  Eigen::Matrix<double, Eigen::Dynamic, 3> by_point(rows, 3);
  VectorXd residuals(rows);
  std::array<std::array<double, 2 * 16>, 5> storage;
  std::array<double*, 5> jacobians{};
  for (int b = 0; b < 5; ++b) jacobians[b] = storage[b].data();
  PointScore& score = point.score;
  score.cells.reserve(terms.size());
  Eigen::Index row = 0;
  for (const JointSystem::Term* term : terms) {
    score.cells.push_back(CellOf(problem, *term));
    double residual[2];
    term->cost.Evaluate(term->values.data(), residual, jacobians.data());
    // Reweighted as at the robust cost's minimum.
    double rho[3] = {0, 1, 0};
    const double squared = residual[0] * residual[0] + residual[1] * residual[1];
    if (loss != nullptr) loss->Evaluate(squared, rho);
    point.loss.push_back({term->weight, term->weight * rho[1], term->weight * (rho[1] + rho[2] * squared)});
    const double root_weight = std::sqrt(term->weight * rho[1]);
    residuals(row) = root_weight * residual[0];
    residuals(row + 1) = root_weight * residual[1];
    for (int b = 0; b < term->num_blocks; ++b) {
      const int size = system.blocks()[term->blocks[b]].size;
      for (int k = 0; k < size; ++k) {
        const int column = column_of[term->blocks[b]][k];
        if (column < 0) continue;
        const auto local = std::lower_bound(touched.begin(), touched.end(), column) - touched.begin();
        by_cameras(row, local) = root_weight * storage[b][k];
        by_cameras(row + 1, local) = root_weight * storage[b][size + k];
      }
    }
    for (int k = 0; k < 3; ++k) {
      by_point(row, k) = root_weight * storage[term->num_blocks][k];
      by_point(row + 1, k) = root_weight * storage[term->num_blocks][3 + k];
    }
    row += 2;
  }
  point.diagonal.resize(by_cameras.cols());
  for (Eigen::Index k = 0; k < by_cameras.cols(); ++k) point.diagonal(k) = by_cameras.col(k).squaredNorm();
  // Elimination by orthogonal projection, so that no square is formed of a matrix that may lack rank.
  Eigen::ColPivHouseholderQR<Eigen::Matrix<double, Eigen::Dynamic, 3>> qr;
  qr.setThreshold(1e-12);
  qr.compute(by_point);
  by_cameras.applyOnTheLeft(qr.householderQ().transpose());
  residuals.applyOnTheLeft(qr.householderQ().transpose());
  const auto left = by_cameras.bottomRows(rows - qr.rank());
  point.redundancy = static_cast<int>(rows - qr.rank());
  point.square = left.transpose() * left;
  // What each observation adds to the gradient once the point has taken its share.
  by_cameras.topRows(qr.rank()).setZero();
  residuals.head(qr.rank()).setZero();
  by_cameras.applyOnTheLeft(qr.householderQ());
  residuals.applyOnTheLeft(qr.householderQ());
  if (terms[0]->of_object) {
    const double height =
        problem.AxisDirection().dot(problem.object.points[static_cast<size_t>(terms[0]->point)]);
    score.weight = terms[0]->weight;
    score.ring = static_cast<int>(std::upper_bound(ring_bounds.begin(), ring_bounds.end(), height) -
                                  ring_bounds.begin());
  }
  score.columns = std::move(touched);
  score.by_cameras = std::move(by_cameras);
  score.residuals = std::move(residuals);
  return point;
}

void AddPoint(EliminatedPoint* point, ReducedSystem* reduced) {
  const std::vector<int>& columns = point->score.columns;
  for (const LossSums& loss : point->loss) reduced->loss.Add(loss);
  reduced->diagonal(columns) += point->diagonal;
  reduced->s(columns, columns) += point->square;
  reduced->redundancy += point->redundancy;
  reduced->scores.push_back(std::move(point->score));
}

}  // namespace

ReducedSystem Reduce(const JointProblem& problem, const JointSystem& system, const ceres::LossFunction* loss,
                     int num_threads) {
  ReducedSystem reduced;
  for (size_t b = 0; b < system.blocks().size(); ++b) {
    const JointSystem::Block& block = system.blocks()[b];
    reduced.column_of.emplace_back(block.size, -1);
    if (!block.used) continue;
    for (const int value : block.free) {
      reduced.column_of.back()[value] = static_cast<int>(reduced.columns.size());
      reduced.columns.push_back({static_cast<int>(b), value});
    }
  }
  const auto size = static_cast<Eigen::Index>(reduced.columns.size());
  reduced.s = MatrixXd::Zero(size, size);
  reduced.diagonal = VectorXd::Zero(size);
  std::map<std::pair<bool, int>, std::vector<const JointSystem::Term*>> by_point;
  for (const JointSystem::Term& term : system.terms())
    by_point[{term.of_object, term.point}].push_back(&term);
  const std::vector<double> ring_bounds = RingBounds(problem);
  std::vector<const std::vector<const JointSystem::Term*>*> points;
  points.reserve(by_point.size());
  for (const auto& [point, terms] : by_point) points.push_back(&terms);
  PrepareAndAdd(
      points.size(), num_threads,
      [&](size_t i) {
        return EliminatePoint(problem, system, loss, ring_bounds, *points[i], reduced.column_of);
      },
      [&](size_t, EliminatedPoint* point) { AddPoint(point, &reduced); });
  return reduced;
}

PriorRow RowOf(const PriorTerm& term, const JointSystem& system, const ReducedSystem& reduced) {
  std::vector<double> values;
  values.reserve(term.parts.size());
  for (const PriorTerm::Part& part : term.parts)
    values.push_back(system.blocks()[part.block].values[part.value]);
  std::vector<double> derivatives;
  PriorRow row{term.Residual(values, &derivatives), VectorXd::Zero(reduced.s.rows())};
  for (size_t k = 0; k < term.parts.size(); ++k) {
    const int column = reduced.column_of[term.parts[k].block][term.parts[k].value];
    if (column >= 0) row.by_columns(column) += derivatives[k];
  }
  return row;
}

PriorSums SumPriors(const JointSystem& system, const ReducedSystem& reduced) {
  const auto size = reduced.s.rows();
  PriorSums sums{MatrixXd::Zero(size, size), MatrixXd::Zero(size, size), MatrixXd::Zero(size, size)};
  for (const PriorTerm& term : system.priors()) {
    const VectorXd jacobian = RowOf(term, system, reduced).by_columns;
    const MatrixXd squared = jacobian * jacobian.transpose();
    sums.information += squared;
    sums.of_gradients += term.scale_px * term.scale_px * squared;
    if (!term.is_seen) sums.known_before += term.scale_px * term.scale_px * squared;
  }
  return sums;
}

double CurvatureShare(const LossSums& sums) {
  return sums.first > 0 ? std::clamp(sums.second / sums.first, kLeastCurvature, 1.0) : 1.0;
}

double NormalVarianceFactor(const ceres::LossFunction* loss, const LossSums& sums, double sigma_px) {
  if (loss == nullptr || !(sigma_px > 0) || !(sums.weights > 0)) return 1;
  double squares = 0;
  double curvature = 0;
  for (int k = 0; k < kQuadrature; ++k) {
    // Squared lengths of normal errors are exponential, with a mean of 2 sigma^2.
    const double squared = -2 * sigma_px * sigma_px * std::log((k + 0.5) / kQuadrature);
    double rho[3];
    loss->Evaluate(squared, rho);
    squares += 0.5 * squared * rho[1] * rho[1];
    curvature += rho[1] + rho[2] * squared;
  }
  squares /= kQuadrature;
  curvature = std::max(curvature / kQuadrature, kLeastCurvature);
  return squares / (sigma_px * sigma_px) * (sums.first / sums.weights) / (curvature * curvature);
}

}  // namespace s2gs
