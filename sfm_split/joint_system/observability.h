#pragma once

#include <Eigen/Core>
#include <string>
#include <utility>
#include <vector>

#include "sfm_split/joint_system/joint_options.h"
#include "sfm_split/joint_system/joint_problem.h"

namespace s2gs {

/// What the linearised system at the solution says, camera side only (points eliminated).
struct Observability {
  bool computed = false;
  int num_parameters = 0;  ///< camera-side, after the gauge.
  int nullity = 0;         ///< eigenvalues of the reduced system, scaled to unit diagonal, that are zero.
  double gap = 0;  ///< smallest eigenvalue that counts over the largest that does not, or over rounding.
  double condition = 0;                      ///< largest eigenvalue over smallest that counts.
  std::vector<std::string> null_directions;  ///< what moves along each, by share, e.g. "focal length 80 %".
  std::vector<std::string> names;            ///< of the parameters.
  std::vector<std::pair<int, int>> parameters;  ///< their block and place in it, as JointSystem counts.
  Eigen::VectorXd eigenvalues;                  ///< ascending.
  /// The covariance's square root but for the eigenvalues: parameters by directions, those that are null
  /// first.
  Eigen::MatrixXd directions;
  /// Of the parameters, when all keypoints' errors are independent; along null directions 0.
  Eigen::MatrixXd covariance;
  /// The same from the residuals themselves, when those of one point depend on each other.
  Eigen::MatrixXd robust_covariance;
  /// And when those in one part of the photos do, too; from few parts, so that it may come out too small.
  Eigen::MatrixXd regional_covariance;
  /// And when those of the points of one ring about the axis do: of highlights, say. From few rings, and not
  /// for a photo's own parameters, which the points of one may tell alone.
  Eigen::MatrixXd ring_covariance;
  /// What of each of these was known before (PriorTerm::is_seen); empty without priors.
  Eigen::MatrixXd prior_covariance;
  /// What wrong observations pull the parameters by (PullOfWrongOnes); empty when not computed.
  Eigen::VectorXd pull;
  /// The variance of the pull when there are no wrong ones, over `covariance`.
  double pull_variance = 0;
};

/// Whether a sum of parameters moves along a null direction, so that nothing tells it and the covariances do
/// not count what it may be.
bool IsUntold(const Observability& observability, const Eigen::VectorXd& weights);

/// The linearised system of a problem as it stands.
/// \param sigma_px  standard deviation of a keypoint's coordinate; scales a loss whose scale is open.
/// \param fix_gauge  false: nothing is held, so that the nullity counts the gauge freedoms too.
Observability AnalyzeObservability(const JointProblem& problem, const JointOptions& asked, bool fix_gauge,
                                   double sigma_px);

}  // namespace s2gs
