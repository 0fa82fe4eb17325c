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

// A sum of parameters, each (block, value) times its weight.
using Weights = std::vector<std::pair<std::pair<int, int>, double>>;

bool HasBackground(const JointProblem& problem) {
  return std::any_of(problem.background.observations.begin(), problem.background.observations.end(),
                     [](const JointObservation& observation) { return observation.active; });
}

class SigmaReport {
 public:
  SigmaReport(const JointProblem& problem, const JointOptions& options, JointReport* report)
      : problem_(problem),
        observability_(report->observability),
        system_(problem, options, true),
        report_(*report) {
    for (size_t k = 0; k < observability_.parameters.size(); ++k)
      index_of_[observability_.parameters[k]] = static_cast<int>(k);
    // A photo's own parameters may rest on the points of one ring; what all photos share does not.
    of_photos_ = {&observability_.covariance, &observability_.robust_covariance,
                  &observability_.regional_covariance};
    of_all_ = of_photos_;
    of_all_.push_back(&observability_.ring_covariance);
  }

  void FillFocalLengths() {
    const Eigen::MatrixXd& of_priors = observability_.prior_covariance;
    for (size_t c = 0; c < problem_.cameras.size(); ++c) {
      const int block = system_.IntrinsicsBlock(static_cast<int>(c));
      const auto found = index_of_.find({block, 0});
      const double of_focal = found == index_of_.end() ? 0 : VarianceOfShared(found->second);
      report_.focal_sigma_px.push_back(std::sqrt(of_focal));
      const bool has_prior = of_priors.size() > 0 && of_focal > 0;
      report_.focal_prior_share.push_back(has_prior ? of_priors(found->second, found->second) / of_focal : 0);
    }
  }

  void FillAngles() {
    std::vector<int> images_of_pose(problem_.cam_from_world.size(), 0);
    for (const JointImage& image : problem_.images) ++images_of_pose[static_cast<size_t>(image.pose)];
    const bool has_background = HasBackground(problem_);
    const Eigen::MatrixXd& of_priors = observability_.prior_covariance;
    for (size_t i = 0; i < problem_.images.size(); ++i) {
      const int pose = problem_.images[i].pose;
      const int own = problem_.free_object ? system_.ObjectPoseBlock(static_cast<int>(i))
                                           : system_.AngleBlock(static_cast<int>(i));
      if (!system_.blocks()[own].used) {  // no keypoint is left
        report_.angle_sigma_deg.push_back(kInfinity);
        report_.turn_sigma_deg.push_back(kInfinity);
        report_.angle_prior_share.push_back(0);
        continue;
      }
      Weights weights = TurnOfObject(own);
      const Weights against_camera = AgainstCamera(weights, pose);
      // A camera of its own whose turn about the axis nothing tells: that of the object against it.
      const bool is_alone =
          !problem_.free_object && !has_background && images_of_pose[static_cast<size_t>(pose)] == 1;
      if (is_alone) weights = against_camera;
      const double of_angle = VarianceOf(weights);
      // What a prior says of the angles inside a station, it says as well where nothing ties the station.
      report_.angle_sigma_deg.push_back(system_.IsTied(pose) || is_alone ? std::sqrt(of_angle) * 180 / kPi
                                                                         : kInfinity);
      report_.turn_sigma_deg.push_back(std::sqrt(VarianceOf(against_camera)) * 180 / kPi);
      const bool has_prior = of_priors.size() > 0 && of_angle > 0;
      report_.angle_prior_share.push_back(has_prior ? VarianceBy(weights, of_priors) / of_angle : 0);
    }
  }

  void FillAxisOfFreePoses() {
    const MatrixXd of_axis = AxisOfFreePoses(problem_, system_, index_of_, observability_.num_parameters);
    const Eigen::Matrix2d pull = CovarianceByPull(observability_, of_axis);
    report_.axis_direction_sigma_deg = 0;
    for (const Eigen::MatrixXd* covariance : of_photos_) {
      const Eigen::Matrix2d axis = of_axis.transpose() * *covariance * of_axis;
      report_.axis_direction_sigma_deg =
          std::max(report_.axis_direction_sigma_deg, WorstSigma(axis + pull) * 180 / kPi);
    }
  }

  void FillAxisAndScale() {
    if (!system_.blocks()[system_.AxisBlock()].used) return;
    // What of all parameters is the axis: four columns, of zeros where one is held.
    MatrixXd of_axis = MatrixXd::Zero(observability_.num_parameters, 4);
    for (int k = 0; k < 4; ++k) {
      const auto found = index_of_.find({system_.AxisBlock(), k});
      if (found != index_of_.end()) of_axis(found->second, k) = 1;
    }
    const Eigen::Matrix2d direction_pull = CovarianceByPull(observability_, of_axis.leftCols<2>());
    const Eigen::Matrix2d point_pull = CovarianceByPull(observability_, of_axis.rightCols<2>());
    report_.axis_direction_sigma_deg = report_.axis_point_sigma = 0;
    for (const Eigen::MatrixXd* covariance : of_all_) {
      Eigen::Matrix4d axis = of_axis.transpose() * *covariance * of_axis;
      axis.topLeftCorner<2, 2>() += direction_pull;
      axis.bottomRightCorner<2, 2>() += point_pull;
      report_.axis_direction_sigma_deg =
          std::max(report_.axis_direction_sigma_deg, WorstSigma(axis.topLeftCorner<2, 2>()) * 180 / kPi);
      report_.axis_point_sigma =
          std::max(report_.axis_point_sigma, WorstSigma(axis.bottomRightCorner<2, 2>()));
    }
    const auto is_untold = [&](int k) { return IsUntold(observability_, of_axis.col(k)); };
    if (is_untold(0) || is_untold(1)) report_.axis_direction_sigma_deg = kInfinity;
    if (is_untold(2) || is_untold(3)) report_.axis_point_sigma = kInfinity;
    report_.scale_sigma_rel = ScaleSigmaRel(problem_, system_, observability_, of_all_, index_of_);
  }

 private:
  // Of a parameter that photos share.
  double VarianceOfShared(int parameter) const {
    const VectorXd alone = VectorXd::Unit(observability_.num_parameters, parameter);
    if (IsUntold(observability_, alone)) return kInfinity;
    double largest = 0;
    for (const Eigen::MatrixXd* covariance : of_all_)
      largest = std::max(largest, (*covariance)(parameter, parameter));
    return largest + VarianceByPull(observability_, alone);
  }

  double VarianceBy(const Weights& weights, const Eigen::MatrixXd& covariance) const {
    double sum = 0;
    for (const auto& [a, weight_a] : weights) {
      for (const auto& [b, weight_b] : weights) {
        const auto first = index_of_.find(a);
        const auto second = index_of_.find(b);
        if (first == index_of_.end() || second == index_of_.end()) continue;
        sum += weight_a * weight_b * covariance(first->second, second->second);
      }
    }
    return sum;
  }

  double VarianceOf(const Weights& weights) const {
    double largest = 0;
    for (const Eigen::MatrixXd* covariance : of_photos_)
      largest = std::max(largest, VarianceBy(weights, *covariance));
    VectorXd of_all = VectorXd::Zero(observability_.num_parameters);
    for (const auto& [parameter, weight] : weights) {
      const auto found = index_of_.find(parameter);
      if (found != index_of_.end()) of_all(found->second) += weight;
    }
    if (IsUntold(observability_, of_all)) return kInfinity;
    return largest + VarianceByPull(observability_, of_all);
  }

  // About the axis, in the world: its angle, or of a pose of its own, whose rotation is exp(w) R.
  Weights TurnOfObject(int own) const {
    if (!problem_.free_object) return {{{own, 0}, 1.0}};
    const Vector3d axis_direction = problem_.AxisDirection();
    Weights weights;
    for (int k = 0; k < 3; ++k) weights.push_back({{own, k}, axis_direction(k)});
    return weights;
  }

  // A camera's rotation is exp(w) R.
  Weights AgainstCamera(Weights weights, int pose) const {
    const Vector3d in_camera =
        problem_.cam_from_world[static_cast<size_t>(pose)].rotation * problem_.AxisDirection();
    for (int k = 0; k < 3; ++k) weights.push_back({{system_.PoseBlock(pose), k}, in_camera(k)});
    return weights;
  }

  const JointProblem& problem_;
  const Observability& observability_;
  JointSystem system_;
  ParameterIndex index_of_;
  Covariances of_photos_;
  Covariances of_all_;  // those of rings beside them
  JointReport& report_;
};

}  // namespace

void FillSigmas(const JointProblem& problem, const JointOptions& options, JointReport* report) {
  if (!report->observability.computed) return;
  SigmaReport sigmas(problem, options, report);
  sigmas.FillFocalLengths();
  sigmas.FillAngles();
  if (problem.free_object) {
    sigmas.FillAxisOfFreePoses();
  } else {
    sigmas.FillAxisAndScale();
  }
}

}  // namespace s2gs
