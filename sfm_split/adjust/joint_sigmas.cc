#include "sfm_split/adjust/joint_sigmas.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <map>
#include <utility>
#include <vector>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/infinity.h"
#include "sfm_split/joint_system/joint_system.h"
#include "sfm_split/solvers/eigen_solvers.h"

namespace s2gs {
namespace {

using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;

using Covariances = std::vector<const Eigen::MatrixXd*>;
using ParameterIndex = std::map<std::pair<int, int>, int>;  // of a block's value in the covariances

// What wrong observations add to the variance of a sum of parameters: the square of their pull, less what of
// it noise alone explains.
double VarianceByPull(const Observability& of, const VectorXd& weights) {
  if (of.pull.size() == 0) return 0;
  const double pull = weights.dot(of.pull);
  return std::max(0.0, pull * pull - of.pull_variance * weights.dot(of.covariance * weights));
}

// The same of two parameters at once.
Eigen::Matrix2d CovarianceByPull(const Observability& of,
                                 const Eigen::Matrix<double, Eigen::Dynamic, 2>& pick) {
  if (of.pull.size() == 0) return Eigen::Matrix2d::Zero();
  const Eigen::Vector2d pull = pick.transpose() * of.pull;
  const Eigen::Matrix2d beyond =
      pull * pull.transpose() - of.pull_variance * pick.transpose() * of.covariance * pick;
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> eigen(beyond);
  return eigen.eigenvectors() * eigen.eigenvalues().cwiseMax(0).asDiagonal() *
         eigen.eigenvectors().transpose();
}

// How the axis about which an object turns that has a pose of its own in each photo, R_i, moves with these
// poses, in the two directions across it: the least squares of (R_i - I) (a + da) + w_i x a over photos.
MatrixXd AxisOfFreePoses(const JointProblem& problem, const JointSystem& system,
                         const ParameterIndex& index_of, int num_parameters) {
  const Vector3d axis = problem.AxisDirection();
  Eigen::Matrix<double, 3, 2> across;
  across.col(0) = axis.unitOrthogonal();
  across.col(1) = axis.cross(across.col(0));
  const Eigen::Matrix3d reference =
      problem.WorldFromObject(problem.reference).rotation.toRotationMatrix().transpose();
  Eigen::Matrix2d normal = Eigen::Matrix2d::Zero();
  MatrixXd of_axis = MatrixXd::Zero(num_parameters, 2);
  for (size_t i = 0; i < problem.images.size(); ++i) {
    const Eigen::Matrix3d turn =
        problem.WorldFromObject(static_cast<int>(i)).rotation.toRotationMatrix() * reference;
    const Eigen::Matrix2d moved = across.transpose() * (turn - Eigen::Matrix3d::Identity()) * across;
    normal += moved.transpose() * moved;
    for (int k = 0; k < 3; ++k) {
      const auto found = index_of.find({system.ObjectPoseBlock(static_cast<int>(i)), k});
      if (found == index_of.end()) continue;
      const Eigen::Vector2d pushed = across.transpose() * Vector3d::Unit(k).cross(axis);
      of_axis.row(found->second) -= (moved.transpose() * pushed).transpose();
    }
  }
  return of_axis * normal.completeOrthogonalDecomposition().pseudoInverse();
}

double WorstSigma(const Eigen::Matrix2d& covariance) {
  return std::sqrt(
      std::max(0.0, Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(covariance).eigenvalues()(1)));
}

// log(scale) = log(distance of the anchor from the axis) - log(distance of the anchor from the station
// farthest from it), by differences over the parameters that it depends on. Infinite when not observable.
double ScaleSigmaRel(const JointProblem& problem, const JointSystem& system,
                     const Observability& observability, const Covariances& covariances,
                     const ParameterIndex& index_of) {
  std::vector<bool> has_background(problem.cam_from_world.size(), false);
  for (const JointObservation& observation : problem.background.observations) {
    if (observation.active) has_background[problem.images[observation.image].pose] = true;
  }
  if (!has_background[system.anchor()]) return kInfinity;
  const Vector3d anchor = system.CentreOfPose(system.anchor());
  int farthest = -1;
  double baseline = 0;
  for (size_t s = 0; s < problem.cam_from_world.size(); ++s) {
    const double distance = (system.CentreOfPose(static_cast<int>(s)) - anchor).norm();
    if (!has_background[s] || !system.IsTied(static_cast<int>(s)) || distance <= baseline) continue;
    baseline = distance;
    farthest = static_cast<int>(s);
  }
  Eigen::Matrix<double, 7, 1> at;
  at.head<4>() = problem.axis;
  const auto log_scale = [&](const Eigen::Matrix<double, 7, 1>& x) {
    const Vector3d direction = Vector3d(x(0), x(1), 1).normalized();
    return std::log(direction.cross(anchor - Vector3d(x(2), x(3), 0)).norm()) -
           std::log((x.tail<3>() - anchor).norm());
  };
  if (farthest < 0) return kInfinity;
  at.tail<3>() = system.CentreOfPose(farthest);
  const double distance = problem.AxisDirection().cross(anchor - problem.AxisPoint()).norm();
  if (distance <= 0 || baseline <= 1e-9 * distance) return kInfinity;
  VectorXd gradient = VectorXd::Zero(covariances[0]->rows());
  for (int k = 0; k < 7; ++k) {
    const auto found = index_of.find(k < 4 ? std::make_pair(system.AxisBlock(), k)
                                           : std::make_pair(system.PoseBlock(farthest), k - 1));
    if (found == index_of.end()) continue;
    const double step = 1e-6 * std::min(distance, baseline);
    Eigen::Matrix<double, 7, 1> above = at;
    Eigen::Matrix<double, 7, 1> below = at;
    above(k) += step;
    below(k) -= step;
    gradient(found->second) = (log_scale(above) - log_scale(below)) / (2 * step);
  }
  double scale_variance = 0;
  for (const Eigen::MatrixXd* covariance : covariances)
    scale_variance = std::max(scale_variance, gradient.dot(*covariance * gradient));
  return std::sqrt(scale_variance + VarianceByPull(observability, gradient));
}

}  // namespace

void FillSigmas(const JointProblem& problem, const JointOptions& options, JointReport* report) {
  const Observability& observability = report->observability;
  if (!observability.computed) return;
  ParameterIndex index_of;
  for (size_t k = 0; k < observability.parameters.size(); ++k) {
    index_of[observability.parameters[k]] = static_cast<int>(k);
  }
  // A photo's own parameters may rest on the points of one ring; what all photos share does not.
  const Covariances of_photos = {&observability.covariance, &observability.robust_covariance,
                                 &observability.regional_covariance};
  Covariances covariances = of_photos;
  covariances.push_back(&observability.ring_covariance);
  const JointSystem system(problem, options, true);
  const auto variance = [&](int block, int value) {
    const auto found = index_of.find({block, value});
    if (found == index_of.end()) return 0.0;
    double largest = 0;
    for (const Eigen::MatrixXd* covariance : covariances)
      largest = std::max(largest, (*covariance)(found->second, found->second));
    return largest +
           VarianceByPull(observability, VectorXd::Unit(observability.num_parameters, found->second));
  };
  const Eigen::MatrixXd& of_priors = observability.prior_covariance;
  for (size_t c = 0; c < problem.cameras.size(); ++c) {
    const int block = system.IntrinsicsBlock(static_cast<int>(c));
    const double of_focal = variance(block, 0);
    report->focal_sigma_px.push_back(std::sqrt(of_focal));
    const auto found = index_of.find({block, 0});
    const bool has_prior = of_priors.size() > 0 && found != index_of.end() && of_focal > 0;
    report->focal_prior_share.push_back(has_prior ? of_priors(found->second, found->second) / of_focal : 0);
  }
  // Of a sum of parameters, each times its weight.
  using Weights = std::vector<std::pair<std::pair<int, int>, double>>;
  const auto variance_by = [&](const Weights& weights, const Eigen::MatrixXd& covariance) {
    double sum = 0;
    for (const auto& [a, weight_a] : weights) {
      for (const auto& [b, weight_b] : weights) {
        const auto first = index_of.find(a);
        const auto second = index_of.find(b);
        if (first == index_of.end() || second == index_of.end()) continue;
        sum += weight_a * weight_b * covariance(first->second, second->second);
      }
    }
    return sum;
  };
  const auto variance_of = [&](const Weights& weights) {
    double largest = 0;
    for (const Eigen::MatrixXd* covariance : of_photos)
      largest = std::max(largest, variance_by(weights, *covariance));
    VectorXd of_all = VectorXd::Zero(observability.num_parameters);
    for (const auto& [parameter, weight] : weights) {
      const auto found = index_of.find(parameter);
      if (found != index_of.end()) of_all(found->second) += weight;
    }
    if (IsUntold(observability, of_all)) return kInfinity;
    return largest + VarianceByPull(observability, of_all);
  };
  const Vector3d axis_direction = problem.AxisDirection();
  // A camera's rotation is exp(w) R.
  const auto add_turn_of_camera = [&](int pose, Weights* weights) {
    const Vector3d in_camera = problem.cam_from_world[static_cast<size_t>(pose)].rotation * axis_direction;
    for (int k = 0; k < 3; ++k) weights->push_back({{system.PoseBlock(pose), k}, in_camera(k)});
  };
  std::vector<int> images_of_pose(problem.cam_from_world.size(), 0);
  for (const JointImage& image : problem.images) ++images_of_pose[static_cast<size_t>(image.pose)];
  const bool has_background =
      std::any_of(problem.background.observations.begin(), problem.background.observations.end(),
                  [](const JointObservation& observation) { return observation.active; });
  for (size_t i = 0; i < problem.images.size(); ++i) {
    const int pose = problem.images[i].pose;
    const int own = problem.free_object ? system.ObjectPoseBlock(static_cast<int>(i))
                                        : system.AngleBlock(static_cast<int>(i));
    if (!system.blocks()[own].used) {  // no keypoint is left
      report->angle_sigma_deg.push_back(kInfinity);
      report->turn_sigma_deg.push_back(kInfinity);
      report->angle_prior_share.push_back(0);
      continue;
    }
    Weights weights;
    if (problem.free_object) {
      // The object's rotation is exp(w) R: about the axis, in the world.
      for (int k = 0; k < 3; ++k) weights.push_back({{own, k}, axis_direction(k)});
    } else {
      weights.push_back({{own, 0}, 1.0});
    }
    Weights against_camera = weights;
    add_turn_of_camera(pose, &against_camera);
    // A camera of its own whose turn about the axis nothing tells: that of the object against it.
    const bool is_alone =
        !problem.free_object && !has_background && images_of_pose[static_cast<size_t>(pose)] == 1;
    if (is_alone) weights = against_camera;
    const double of_angle = variance_of(weights);
    // What a prior says of the angles inside a station, it says as well where nothing ties the station.
    report->angle_sigma_deg.push_back(system.IsTied(pose) || is_alone ? std::sqrt(of_angle) * 180 / kPi
                                                                      : kInfinity);
    report->turn_sigma_deg.push_back(std::sqrt(variance_of(against_camera)) * 180 / kPi);
    const bool has_prior = of_priors.size() > 0 && of_angle > 0;
    report->angle_prior_share.push_back(has_prior ? variance_by(weights, of_priors) / of_angle : 0);
  }
  if (problem.free_object) {
    const MatrixXd of_axis = AxisOfFreePoses(problem, system, index_of, observability.num_parameters);
    const Eigen::Matrix2d pull = CovarianceByPull(observability, of_axis);
    report->axis_direction_sigma_deg = 0;
    for (const Eigen::MatrixXd* covariance : of_photos) {
      const Eigen::Matrix2d axis = of_axis.transpose() * *covariance * of_axis;
      report->axis_direction_sigma_deg =
          std::max(report->axis_direction_sigma_deg, WorstSigma(axis + pull) * 180 / kPi);
    }
    return;
  }
  if (!system.blocks()[system.AxisBlock()].used) return;
  // What of all parameters is the axis: four columns, of zeros where one is held.
  MatrixXd of_axis = MatrixXd::Zero(observability.num_parameters, 4);
  for (int k = 0; k < 4; ++k) {
    const auto found = index_of.find({system.AxisBlock(), k});
    if (found != index_of.end()) of_axis(found->second, k) = 1;
  }
  const Eigen::Matrix2d direction_pull = CovarianceByPull(observability, of_axis.leftCols<2>());
  const Eigen::Matrix2d point_pull = CovarianceByPull(observability, of_axis.rightCols<2>());
  report->axis_direction_sigma_deg = report->axis_point_sigma = 0;
  for (const Eigen::MatrixXd* covariance : covariances) {
    Eigen::Matrix4d axis = of_axis.transpose() * *covariance * of_axis;
    axis.topLeftCorner<2, 2>() += direction_pull;
    axis.bottomRightCorner<2, 2>() += point_pull;
    report->axis_direction_sigma_deg =
        std::max(report->axis_direction_sigma_deg, WorstSigma(axis.topLeftCorner<2, 2>()) * 180 / kPi);
    report->axis_point_sigma = std::max(report->axis_point_sigma, WorstSigma(axis.bottomRightCorner<2, 2>()));
  }
  report->scale_sigma_rel = ScaleSigmaRel(problem, system, observability, covariances, index_of);
}

}  // namespace s2gs
