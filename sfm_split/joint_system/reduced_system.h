#pragma once

#include <ceres/loss_function.h>

#include <Eigen/Core>
#include <vector>

#include "sfm_split/joint_system/joint_problem.h"
#include "sfm_split/joint_system/joint_system.h"

namespace s2gs {

/// A parameter of the reduced system: a value of one of JointSystem's blocks.
struct ReducedColumn {
  int block;
  int value;
};

/// A point's observations with the point eliminated: what they say of the cameras' side.
struct PointScore {
  std::vector<int> columns;    ///< of the reduced system, ascending.
  Eigen::MatrixXd by_cameras;  ///< derivatives by these, two rows for each observation, weighed.
  Eigen::VectorXd residuals;   ///< weighed alike.
  std::vector<int> cells;      ///< where in the photos each observation lies.
  double weight = 1;           ///< of its observations: the mean.
  int ring = -1;               ///< about the axis, in which the point lies; -1: of the background.

  Eigen::VectorXd Gradient() const { return by_cameras.transpose() * residuals; }
  Eigen::VectorXd GradientOf(Eigen::Index observation) const {
    return by_cameras.middleRows<2>(2 * observation).transpose() * residuals.segment<2>(2 * observation);
  }
};

/// What the loss makes of the residuals, summed over observations.
struct LossSums {
  double weights = 0;  ///< of the observations themselves.
  double first = 0;    ///< times the loss' first derivative, as in S.
  double second = 0;   ///< times the curvature of the loss, mean of both directions.

  void Add(const LossSums& other) {
    weights += other.weights;
    first += other.first;
    second += other.second;
  }
};

/// The reduced normal equations: S = sum over points of Jc^T Jc - Jc^T Jp (Jp^T Jp)^-1 Jp^T Jc, reweighted as
/// at the robust cost's minimum.
struct ReducedSystem {
  std::vector<ReducedColumn> columns;
  std::vector<std::vector<int>> column_of;  ///< [block][value], -1 when held or unused.
  Eigen::MatrixXd s;
  Eigen::VectorXd diagonal;  ///< of sum Jc^T Jc.
  int redundancy = 0;        ///< residuals left by the points.
  std::vector<PointScore> scores;
  LossSums loss;
};

/// The same bits for any number of threads. \param loss  null for squares.
ReducedSystem Reduce(const JointProblem& problem, const JointSystem& system, const ceres::LossFunction* loss,
                     int num_threads);

/// A prior's residual [px] at a system's values, and its derivatives by the reduced system's columns.
struct PriorRow {
  double residual = 0;
  Eigen::VectorXd by_columns;
};
PriorRow RowOf(const PriorTerm& term, const JointSystem& system, const ReducedSystem& reduced);

/// The priors' second derivatives, and the covariance of their gradients, by the reduced system's columns.
struct PriorSums {
  Eigen::MatrixXd information;
  Eigen::MatrixXd of_gradients;  ///< of all.
  Eigen::MatrixXd known_before;  ///< of those that no photo shows (PriorTerm::is_seen).
};
PriorSums SumPriors(const JointSystem& system, const ReducedSystem& reduced);

/// The loss' curvature over its weights: how much less than S the robust cost's own second derivatives are.
double CurvatureShare(const LossSums& sums);

/// The variance of the robust estimate over that of the mean of squares' with S for its information, when
/// errors are normal and independent: E[psi^2] E[weight] / (sigma^2 E[curvature]^2), of which the weights are
/// those in S. \param loss  null for squares, whose factor is 1.
double NormalVarianceFactor(const ceres::LossFunction* loss, const LossSums& sums, double sigma_px);

}  // namespace s2gs
