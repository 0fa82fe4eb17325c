#include <ceres/loss_function.h>

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <memory>
#include <utility>

#include "sfm_split/adjust/joint_ba.h"
#include "sfm_split/adjust/joint_system.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/solvers/eigen_solvers.h"

namespace s2gs {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

// Eigenvalues of the reduced system, with unit diagonal before the points' elimination, that are below this
// times the largest are zero: rounding leaves about 1e-15.
constexpr double kZeroEigenvalue = 1e-12;
constexpr double kRounding = 1e-16;
constexpr int kCells = 12;        // of a photo, in each direction, in which errors may depend on each other
constexpr int kQuadrature = 400;  // quantiles of a Rayleigh-distributed error, at which a mean is taken
constexpr double kLeastCurvature = 0.1;  // of the robust cost, over that of squares
constexpr size_t kRings = 6;             // of the object about the axis, each with as many points
constexpr size_t kPointsAtOnce = 1024;   // that threads prepare before they are summed in their order

struct Column {
  int block;
  int value;
};

// A point's observations with the point eliminated.
struct PointScore {
  std::vector<int> columns;
  MatrixXd by_cameras;  // two rows for each observation
  VectorXd residuals;
  std::vector<int> cells;  // where in the photos each observation lies
  int ring = -1;           // about the axis, in which the point lies; -1: of the background

  VectorXd Gradient() const { return by_cameras.transpose() * residuals; }
  VectorXd GradientOf(Eigen::Index observation) const {
    return by_cameras.middleRows<2>(2 * observation).transpose() * residuals.segment<2>(2 * observation);
  }
};

// What the loss makes of the residuals, summed over observations.
struct LossSums {
  double weights = 0;  // of the observations themselves
  double first = 0;    // times the loss' first derivative, as in S
  double second = 0;   // times the curvature of the loss, mean of both directions

  void Add(const LossSums& other) {
    weights += other.weights;
    first += other.first;
    second += other.second;
  }
};

// What one point adds to the reduced system.
struct EliminatedPoint {
  PointScore score;
  VectorXd diagonal;
  MatrixXd square;
  int redundancy = 0;
  std::vector<LossSums> loss;  // of each observation
};

// Calls `prepare(i)` for all i below `count` on several threads, and `add(i, prepared)` in the order of i, so
// that sums have the same bits however many threads there are.
template <typename Prepare, typename Add>
void PrepareAndAdd(size_t count, int num_threads, const Prepare& prepare, const Add& add) {
  std::vector<decltype(prepare(size_t{0}))> prepared;
  for (size_t begin = 0; begin < count; begin += kPointsAtOnce) {
    const size_t here = std::min(kPointsAtOnce, count - begin);
    prepared.clear();
    prepared.resize(here);
    ParallelFor(static_cast<int64_t>(here), num_threads, [&](int64_t i) {
      prepared[static_cast<size_t>(i)] = prepare(begin + static_cast<size_t>(i));
    });
    for (size_t i = 0; i < here; ++i) add(begin + i, &prepared[i]);
  }
}

// The reduced normal equations: S = sum over points of Jc^T Jc - Jc^T Jp (Jp^T Jp)^-1 Jp^T Jc.
struct ReducedSystem {
  std::vector<Column> columns;
  std::vector<std::vector<int>> column_of;  // [block][value], -1 when held or unused
  MatrixXd s;
  VectorXd diagonal;   // of sum Jc^T Jc
  int redundancy = 0;  // residuals left by the points
  std::vector<PointScore> scores;
  LossSums loss;
};

// The part of the photos of one camera in which a keypoint lies.
int CellOf(const JointProblem& problem, const JointSystem::Term& term) {
  const int camera = problem.images[static_cast<size_t>(term.image)].camera;
  const Camera& size = problem.cameras[static_cast<size_t>(camera)];
  const Eigen::Vector2d xy = term.cost->xy();
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
    term->cost->Evaluate(term->values.data(), residual, jacobians.data());
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
  for (size_t a = 0; a < columns.size(); ++a) {
    reduced->diagonal(columns[a]) += point->diagonal(static_cast<Eigen::Index>(a));
    for (size_t b = 0; b < columns.size(); ++b) {
      reduced->s(columns[a], columns[b]) +=
          point->square(static_cast<Eigen::Index>(a), static_cast<Eigen::Index>(b));
    }
  }
  reduced->redundancy += point->redundancy;
  reduced->scores.push_back(std::move(point->score));
}

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

// The priors' second derivatives, and the covariance of their gradients.
struct PriorSums {
  MatrixXd information;
  MatrixXd of_gradients;
};

PriorSums SumPriors(const JointSystem& system, const ReducedSystem& reduced) {
  const auto size = reduced.s.rows();
  PriorSums sums{MatrixXd::Zero(size, size), MatrixXd::Zero(size, size)};
  for (const PriorTerm& term : system.priors()) {
    std::vector<double> values;
    for (const PriorTerm::Part& part : term.parts)
      values.push_back(system.blocks()[part.block].values[part.value]);
    std::vector<double> derivatives;
    term.Residual(values, &derivatives);
    VectorXd jacobian = VectorXd::Zero(size);
    for (size_t k = 0; k < term.parts.size(); ++k) {
      const int column = reduced.column_of[term.parts[k].block][term.parts[k].value];
      if (column >= 0) jacobian(column) += derivatives[k];
    }
    sums.information += jacobian * jacobian.transpose();
    sums.of_gradients += term.scale_px * term.scale_px * jacobian * jacobian.transpose();
  }
  return sums;
}

// The covariance of the gradient, from the observations' own shares of it.
struct ScoreCovariance {
  MatrixXd of_points;   // errors of the keypoints of one point may depend on each other
  MatrixXd of_regions;  // and so may those in one part of the photos
  MatrixXd of_rings;    // or in one ring about the axis
};

// All that the points of one ring say.
struct RingScore {
  VectorXd gradient;
  MatrixXd information;
};

// The points of a ring pass the same places of the picture in the same light, so that highlights, shading and
// foreshortening, which stay in the world, move all of them alike, however many they are: rings as clusters,
// each left out in turn (the jackknife). Background points stay clusters of their own.
MatrixXd CovarianceOfRings(const ReducedSystem& reduced, const MatrixXd& inverse_system,
                           const MatrixXd& of_background) {
  const auto size = reduced.s.rows();
  std::map<int, RingScore> rings;
  for (const PointScore& score : reduced.scores) {
    if (score.ring < 0) continue;
    RingScore& ring =
        rings.try_emplace(score.ring, RingScore{VectorXd::Zero(size), MatrixXd::Zero(size, size)})
            .first->second;
    const VectorXd gradient = score.Gradient();
    const MatrixXd square = score.by_cameras.transpose() * score.by_cameras;
    for (size_t a = 0; a < score.columns.size(); ++a) {
      ring.gradient(score.columns[a]) += gradient(static_cast<Eigen::Index>(a));
      for (size_t b = 0; b < score.columns.size(); ++b) {
        ring.information(score.columns[a], score.columns[b]) +=
            square(static_cast<Eigen::Index>(a), static_cast<Eigen::Index>(b));
      }
    }
  }
  MatrixXd sum = of_background;
  const auto count = static_cast<double>(rings.size());
  for (const auto& [height, ring] : rings) {
    const MatrixXd left = MatrixXd::Identity(size, size) - ring.information * inverse_system;
    VectorXd without = left.partialPivLu().solve(ring.gradient);
    if (!without.allFinite()) without = ring.gradient;
    sum += (count - 1) / count * without * without.transpose();
  }
  return sum;
}

// Liang and Zeger's estimate with points as clusters, with the gradients that these would have without their
// own pull on the parameters (the jackknife, Bell and McCaffrey's CR3): with few points to many parameters,
// residuals are much smaller than errors. Shading and foreshortening move features alike in one part of the
// photos: parts as clusters are added, less, as Cameron, Gelbach and Miller join two ways of clustering, what
// both count.
ScoreCovariance CovarianceOfScores(const ReducedSystem& reduced, const MatrixXd& inverse_system,
                                   int num_threads) {
  const auto size = reduced.s.rows();
  const auto redundancy = static_cast<double>(reduced.redundancy);
  const double growth = redundancy / std::max(1.0, redundancy - static_cast<double>(size));
  ScoreCovariance sums{MatrixXd::Zero(size, size), MatrixXd::Zero(size, size), MatrixXd()};
  MatrixXd of_background = MatrixXd::Zero(size, size);
  std::map<int, VectorXd> by_cell;
  struct Prepared {
    VectorXd of_point;
    MatrixXd of_observations;
    std::vector<VectorXd> gradients;  // of each observation
  };
  const auto prepare = [&](size_t i) {
    const PointScore& score = reduced.scores[i];
    const auto columns = static_cast<Eigen::Index>(score.columns.size());
    MatrixXd inverse(columns, columns);
    for (Eigen::Index a = 0; a < columns; ++a) {
      for (Eigen::Index b = 0; b < columns; ++b)
        inverse(a, b) = inverse_system(score.columns[a], score.columns[b]);
    }
    const MatrixXd left =
        MatrixXd::Identity(columns, columns) - score.by_cameras.transpose() * (score.by_cameras * inverse);
    Prepared point;
    point.of_point = left.partialPivLu().solve(score.Gradient());
    if (!point.of_point.allFinite()) point.of_point = score.Gradient();
    point.of_observations = MatrixXd::Zero(columns, columns);
    point.gradients.reserve(score.cells.size());
    for (size_t k = 0; k < score.cells.size(); ++k) {
      point.gradients.push_back(score.GradientOf(static_cast<Eigen::Index>(k)));
      point.of_observations += growth * point.gradients[k] * point.gradients[k].transpose();
    }
    return point;
  };
  PrepareAndAdd(reduced.scores.size(), num_threads, prepare, [&](size_t i, const Prepared* point) {
    const PointScore& score = reduced.scores[i];
    const auto columns = static_cast<Eigen::Index>(score.columns.size());
    const VectorXd& of_point = point->of_point;
    for (size_t k = 0; k < score.cells.size(); ++k) {
      VectorXd& cell = by_cell.try_emplace(score.cells[k], VectorXd::Zero(size)).first->second;
      for (Eigen::Index a = 0; a < columns; ++a) cell(score.columns[a]) += point->gradients[k](a);
    }
    for (Eigen::Index a = 0; a < columns; ++a) {
      for (Eigen::Index b = 0; b < columns; ++b) {
        sums.of_points(score.columns[a], score.columns[b]) += of_point(a) * of_point(b);
        if (score.ring < 0) of_background(score.columns[a], score.columns[b]) += of_point(a) * of_point(b);
        sums.of_regions(score.columns[a], score.columns[b]) -= point->of_observations(a, b);
      }
    }
  });
  MatrixXd cells(size, static_cast<Eigen::Index>(by_cell.size()));
  Eigen::Index next = 0;
  for (const auto& [cell, gradient] : by_cell) cells.col(next++) = gradient;
  const auto num_cells = static_cast<double>(by_cell.size());
  sums.of_regions += sums.of_points;
  sums.of_regions += cells * cells.transpose() * (growth * num_cells / std::max(1.0, num_cells - 1));
  sums.of_rings = CovarianceOfRings(reduced, inverse_system, of_background);
  return sums;
}

// The loss' curvature over its weights: how much less than S the robust cost's own second derivatives are.
double CurvatureShare(const LossSums& sums) {
  return sums.first > 0 ? std::clamp(sums.second / sums.first, kLeastCurvature, 1.0) : 1.0;
}

// The variance of the robust estimate over that of the mean of squares' with S for its information, when
// errors are normal and independent: E[psi^2] E[weight] / (sigma^2 E[curvature]^2), of which the weights are
// those in S.
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

std::string ColumnName(const JointSystem& system, const JointProblem& problem, const Column& column) {
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

Observability AnalyzeObservability(const JointProblem& problem, const JointOptions& asked, bool fix_gauge,
                                   double sigma_px) {
  JointOptions options = asked;
  if (options.loss_scale_px == 0) options.loss_scale_px = LossScalePx(sigma_px);
  Observability result;
  const JointSystem system(problem, options, fix_gauge);
  int free = 0;
  for (const JointSystem::Block& block : system.blocks()) {
    if (block.used) free += static_cast<int>(block.free.size());
  }
  result.num_parameters = free;
  if (free == 0 || free > options.max_dense_parameters) return result;

  const std::unique_ptr<ceres::LossFunction> loss = MakeLoss(options);
  const ReducedSystem reduced = Reduce(problem, system, loss.get(), options.num_threads);
  for (const Column& column : reduced.columns) {
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
  const MatrixXd inverse_system = half * inverse.asDiagonal() * half.transpose();
  const double variance = NormalVarianceFactor(loss.get(), reduced.loss, sigma_px) * sigma_px * sigma_px;
  result.covariance = variance * inverse_system;
  if (has_priors) {
    result.prior_covariance = inverse_system * priors.of_gradients * inverse_system;
    result.covariance = variance * inverse_system * reduced.s * inverse_system + result.prior_covariance;
  }
  const ScoreCovariance scores = CovarianceOfScores(reduced, inverse_system, options.num_threads);
  result.robust_covariance = inverse_system * scores.of_points * inverse_system / (share * share);
  result.regional_covariance = inverse_system * scores.of_regions * inverse_system / (share * share);
  result.ring_covariance = inverse_system * scores.of_rings * inverse_system / (share * share);
  if (has_priors) {
    result.ring_covariance += result.prior_covariance;
    result.robust_covariance += result.prior_covariance;
    result.regional_covariance += result.prior_covariance;
  }
  return result;
}

}  // namespace s2gs
