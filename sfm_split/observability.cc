#include <ceres/loss_function.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <memory>
#include <utility>

#include "sfm_split/joint_ba.h"
#include "sfm_split/joint_system.h"

namespace s2gs {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

// Eigenvalues of the reduced system, with unit diagonal before the points' elimination, that are below this
// times the largest are zero: rounding leaves about 1e-15.
constexpr double kZeroEigenvalue = 1e-12;
constexpr double kRounding = 1e-16;

struct Column {
  int block;
  int value;
};

// The gradient of a point's cost by the cameras' parameters, the point eliminated.
struct PointScore {
  std::vector<int> columns;
  VectorXd gradient;
};

// The reduced normal equations: S = sum over points of Jc^T Jc - Jc^T Jp (Jp^T Jp)^-1 Jp^T Jc.
struct ReducedSystem {
  std::vector<Column> columns;
  std::vector<std::vector<int>> column_of;  // [block][value], -1 when held or unused
  MatrixXd s;
  VectorXd diagonal;   // of sum Jc^T Jc
  int redundancy = 0;  // residuals left by the points
  std::vector<PointScore> scores;
};

void EliminatePoint(const JointSystem& system, const ceres::LossFunction* loss,
                    const std::vector<const JointSystem::Term*>& terms, ReducedSystem* reduced) {
  std::vector<int> touched;
  for (const JointSystem::Term* term : terms) {
    for (int b = 0; b < term->num_blocks; ++b) {
      for (const int column : reduced->column_of[term->blocks[b]]) {
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
  Eigen::Index row = 0;
  for (const JointSystem::Term* term : terms) {
    double residual[2];
    term->cost->Evaluate(term->values.data(), residual, jacobians.data());
    // Reweighted as at the robust cost's minimum.
    double rho[3] = {0, 1, 0};
    if (loss != nullptr) loss->Evaluate(residual[0] * residual[0] + residual[1] * residual[1], rho);
    const double root_weight = std::sqrt(term->weight * rho[1]);
    residuals(row) = root_weight * residual[0];
    residuals(row + 1) = root_weight * residual[1];
    for (int b = 0; b < term->num_blocks; ++b) {
      const int size = system.blocks()[term->blocks[b]].size;
      for (int k = 0; k < size; ++k) {
        const int column = reduced->column_of[term->blocks[b]][k];
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
  for (size_t k = 0; k < touched.size(); ++k) {
    reduced->diagonal(touched[k]) += by_cameras.col(static_cast<Eigen::Index>(k)).squaredNorm();
  }
  // Elimination by orthogonal projection, so that no square is formed of a matrix that may lack rank.
  Eigen::ColPivHouseholderQR<Eigen::Matrix<double, Eigen::Dynamic, 3>> qr;
  qr.setThreshold(1e-12);
  qr.compute(by_point);
  by_cameras.applyOnTheLeft(qr.householderQ().transpose());
  residuals.applyOnTheLeft(qr.householderQ().transpose());
  const auto left = by_cameras.bottomRows(rows - qr.rank());
  reduced->redundancy += static_cast<int>(rows - qr.rank());
  reduced->scores.push_back({touched, left.transpose() * residuals.tail(rows - qr.rank())});
  const MatrixXd square = left.transpose() * left;
  for (size_t a = 0; a < touched.size(); ++a) {
    for (size_t b = 0; b < touched.size(); ++b) {
      reduced->s(touched[a], touched[b]) +=
          square(static_cast<Eigen::Index>(a), static_cast<Eigen::Index>(b));
    }
  }
}

ReducedSystem Reduce(const JointSystem& system, const ceres::LossFunction* loss) {
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
  for (const auto& [point, terms] : by_point) EliminatePoint(system, loss, terms, &reduced);
  return reduced;
}

// The covariance of the sum of the points' gradients, from the gradients themselves: errors of the keypoints
// of one point may depend on each other (Liang and Zeger's estimate, with points as clusters).
MatrixXd ScoreCovariance(const ReducedSystem& reduced) {
  const auto size = reduced.s.rows();
  MatrixXd sum = MatrixXd::Zero(size, size);
  for (const PointScore& score : reduced.scores) {
    for (size_t a = 0; a < score.columns.size(); ++a) {
      for (size_t b = 0; b < score.columns.size(); ++b) {
        sum(score.columns[a], score.columns[b]) +=
            score.gradient(static_cast<Eigen::Index>(a)) * score.gradient(static_cast<Eigen::Index>(b));
      }
    }
  }
  const auto redundancy = static_cast<double>(reduced.redundancy);
  return sum * (redundancy / std::max(1.0, redundancy - static_cast<double>(size)));
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
  const ReducedSystem reduced = Reduce(system, loss.get());
  for (const Column& column : reduced.columns) {
    result.names.push_back(ColumnName(system, problem, column));
    result.parameters.emplace_back(column.block, column.value);
  }
  const VectorXd scale = (reduced.diagonal.array() > 0)
                             .select(reduced.diagonal.array().sqrt().inverse(), VectorXd::Zero(free).array());
  const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(
      MatrixXd(scale.asDiagonal() * reduced.s * scale.asDiagonal()));
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
  result.covariance = sigma_px * sigma_px * inverse_system;
  result.robust_covariance = inverse_system * ScoreCovariance(reduced) * inverse_system;
  return result;
}

}  // namespace s2gs
