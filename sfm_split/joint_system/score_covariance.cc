#include "sfm_split/joint_system/score_covariance.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <map>
#include <vector>

#include "sfm_split/joint_system/prepare_and_add.h"

namespace s2gs {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

// All that the points of one ring say.
struct RingScore {
  VectorXd gradient;
  MatrixXd information;
};

// The points of a ring pass the same places of the picture in the same light, so that highlights, shading and
// foreshortening, which stay in the world, move all of them alike, however many they are: rings as clusters,
// each left out in turn (the jackknife). Background points stay clusters of their own.
MatrixXd CovarianceOfRings(const ReducedSystem& reduced, const MatrixXd& inverse_system,
                           const MatrixXd& of_background, int num_threads) {
  const auto size = reduced.s.rows();
  std::map<int, RingScore> rings;
  const auto information = [&](size_t i) {
    const PointScore& score = reduced.scores[i];
    return score.ring < 0 ? MatrixXd() : MatrixXd(score.by_cameras.transpose() * score.by_cameras);
  };
  PrepareAndAdd(reduced.scores.size(), num_threads, information, [&](size_t i, const MatrixXd* of_point) {
    const PointScore& score = reduced.scores[i];
    if (score.ring < 0) return;
    RingScore& ring =
        rings.try_emplace(score.ring, RingScore{VectorXd::Zero(size), MatrixXd::Zero(size, size)})
            .first->second;
    ring.gradient(score.columns) += score.Gradient() / std::sqrt(score.weight);
    ring.information(score.columns, score.columns) += *of_point;
  });
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

}  // namespace

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
    const MatrixXd inverse = inverse_system(score.columns, score.columns);
    const MatrixXd left =
        MatrixXd::Identity(columns, columns) - score.by_cameras.transpose() * (score.by_cameras * inverse);
    Prepared point;
    const double back = 1 / std::sqrt(score.weight);
    point.of_point = left.partialPivLu().solve(back * score.Gradient());
    if (!point.of_point.allFinite()) point.of_point = back * score.Gradient();
    point.of_observations = MatrixXd::Zero(columns, columns);
    point.gradients.reserve(score.cells.size());
    for (size_t k = 0; k < score.cells.size(); ++k) {
      point.gradients.push_back(back * score.GradientOf(static_cast<Eigen::Index>(k)));
      point.of_observations += growth * point.gradients[k] * point.gradients[k].transpose();
    }
    return point;
  };
  PrepareAndAdd(reduced.scores.size(), num_threads, prepare, [&](size_t i, const Prepared* point) {
    const PointScore& score = reduced.scores[i];
    const VectorXd& of_point = point->of_point;
    for (size_t k = 0; k < score.cells.size(); ++k) {
      VectorXd& cell = by_cell.try_emplace(score.cells[k], VectorXd::Zero(size)).first->second;
      cell(score.columns) += point->gradients[k];
    }
    const MatrixXd square = of_point * of_point.transpose();
    sums.of_points(score.columns, score.columns) += square;
    if (score.ring < 0) of_background(score.columns, score.columns) += square;
    sums.of_regions(score.columns, score.columns) -= point->of_observations;
  });
  MatrixXd cells(size, static_cast<Eigen::Index>(by_cell.size()));
  Eigen::Index next = 0;
  for (const auto& [cell, gradient] : by_cell) cells.col(next++) = gradient;
  const auto num_cells = static_cast<double>(by_cell.size());
  sums.of_regions += sums.of_points;
  sums.of_regions += cells * cells.transpose() * (growth * num_cells / std::max(1.0, num_cells - 1));
  sums.of_rings = CovarianceOfRings(reduced, inverse_system, of_background, num_threads);
  return sums;
}

}  // namespace s2gs
