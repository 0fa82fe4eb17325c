#include "sfm_split/single_axis/single_axis_adjust.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <utility>

#include "sfm_split/base/angles.h"
#include "sfm_split/single_axis/turn_epipolar.h"
#include "sfm_split/solvers/eigen_solvers.h"

namespace s2gs {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

}  // namespace

AxisNormal AdjustAxisAndTurns(const AxisRays& rays, int reference, double scale_px, int iterations,
                              Reporter& reporter, TurntableAxis* axis, ImageTurns* turns) {
  AxisNormal normal;
  if (reference < 0) return normal;
  const int num = rays.AxisParameters();
  normal.column.assign(rays.cameras.size(), -1);
  int size = num;
  for (size_t i = 0; i < rays.cameras.size(); ++i) {
    if (turns->connected[i] != 0 && static_cast<int>(i) != reference) normal.column[i] = size++;
  }
  MatrixXd& matrix = normal.matrix;
  for (int iteration = 0; iteration < iterations; ++iteration) {
    if (reporter.StopRequested()) throw Interrupted();
    const AxisFrame frame = FrameAcross(axis->direction, rays.sight);
    matrix = MatrixXd::Zero(size, size);
    VectorXd right = VectorXd::Zero(size);
    for (const RayPair& pair : rays.pairs) {
      if (turns->connected[pair.image1] == 0 || turns->connected[pair.image2] == 0) continue;
      Eigen::Matrix<double, 5, 5> of_pair = Eigen::Matrix<double, 5, 5>::Zero();
      Eigen::Matrix<double, 5, 1> gradient = Eigen::Matrix<double, 5, 1>::Zero();
      LinearizePair(rays, pair, *axis, frame, turns->angles[pair.image2] - turns->angles[pair.image1],
                    scale_px,
                    [&](double error, const Eigen::Matrix<double, 5, 1>& derivative, double weight) {
                      of_pair += weight * derivative * derivative.transpose();
                      gradient += weight * derivative * error;
                    });
      const int first = normal.column[pair.image1];
      const int second = normal.column[pair.image2];
      matrix.topLeftCorner(num, num) += of_pair.topLeftCorner(num, num);
      right.head(num) -= gradient.head(num);
      for (const auto& [at, sign] : {std::make_pair(first, -1.0), std::make_pair(second, 1.0)}) {
        if (at < 0) continue;
        matrix.block(0, at, num, 1) += sign * of_pair.block(0, 4, num, 1);
        matrix.block(at, 0, 1, num) += sign * of_pair.block(4, 0, 1, num);
        matrix(at, at) += of_pair(4, 4);
        right(at) -= sign * gradient(4);
      }
      if (first >= 0 && second >= 0) {
        matrix(first, second) -= of_pair(4, 4);
        matrix(second, first) -= of_pair(4, 4);
      }
    }
    const VectorXd diagonal = matrix.diagonal();
    matrix.diagonal() += 1e-9 * diagonal;
    VectorXd step = matrix.ldlt().solve(right);
    matrix.diagonal() = diagonal;
    if (!step.allFinite()) return {};
    const double longest = step.cwiseAbs().maxCoeff();
    if (longest > 0.2) step *= 0.2 / longest;
    *axis = MovedAxis(rays, *axis, frame, step);
    for (size_t i = 0; i < rays.cameras.size(); ++i) {
      if (normal.column[i] >= 0) turns->angles[i] += step(normal.column[i]);
    }
    if (longest < 1e-13) break;
  }
  return normal;
}

AxisSigmas SigmasOf(const AxisRays& rays, const AxisNormal& normal, double sigma_px) {
  AxisSigmas sigmas;
  sigmas.of_turn_deg.assign(rays.cameras.size(), 0);
  if (normal.matrix.size() == 0) return sigmas;
  const MatrixXd inverse = normal.matrix.completeOrthogonalDecomposition().pseudoInverse();
  const double variance = sigma_px * sigma_px;
  const auto worst = [&](int at, int count, double unit) {
    const MatrixXd block = variance * inverse.block(at, at, count, count);
    return unit *
           std::sqrt(std::max(0.0, Eigen::SelfAdjointEigenSolver<MatrixXd>(block).eigenvalues()(count - 1)));
  };
  sigmas.direction_deg = worst(0, 2, 1 / kDegree);
  sigmas.point = worst(2, rays.AxisParameters() - 2, rays.radius);
  for (size_t i = 0; i < rays.cameras.size(); ++i) {
    if (normal.column[i] >= 0) sigmas.of_turn_deg[i] = worst(normal.column[i], 1, 1 / kDegree);
  }
  return sigmas;
}

}  // namespace s2gs
