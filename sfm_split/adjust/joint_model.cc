#include "sfm_split/adjust/joint_model.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <memory>

#include "sfm_split/joint_system/joint_system.h"

namespace s2gs {
namespace {

using Eigen::Vector2d;

// Score statistic of each image for a camera pose of its own, from one body's observations with the structure
// held: g^T (s^2 sum J^T J)^-1 g / 6, with g the gradient of the robust cost. Its mean is 1 under the simple
// model (a little less, since other parameters are fitted); images with too few observations give -1.
// Weights of observations do not enter: they discount what the photos of a station repeat, and within one
// image every point is seen once, with errors of its own and one variance.
std::vector<double> PoseScores(const JointProblem& problem, const JointOptions& options, bool of_object) {
  const JointSystem system(problem, options, true);
  const std::unique_ptr<ceres::LossFunction> loss = MakeLoss(options);
  using Vector6 = Eigen::Matrix<double, 6, 1>;
  using Matrix6 = Eigen::Matrix<double, 6, 6>;
  std::vector<Vector6> gradient(problem.images.size(), Vector6::Zero());
  std::vector<Matrix6> information(problem.images.size(), Matrix6::Zero());
  std::vector<int> counts(problem.images.size(), 0);
  double squares = 0;
  int count = 0;
  for (const JointSystem::Term& term : system.terms()) {
    if (term.of_object != of_object) continue;
    Eigen::Matrix<double, 2, 6, Eigen::RowMajor> by_pose;
    std::array<double*, 5> jacobians{};
    jacobians[0] = by_pose.data();
    Vector2d residual;
    term.cost.Evaluate(term.values.data(), residual.data(), jacobians.data());
    double rho[3] = {0, 1, 0};
    if (loss) loss->Evaluate(residual.squaredNorm(), rho);
    const Vector2d weighted = rho[1] * residual;
    gradient[term.image] += by_pose.transpose() * weighted;
    information[term.image] += by_pose.transpose() * by_pose;
    ++counts[term.image];
    squares += weighted.squaredNorm();
    count += 2;
  }
  const double variance = std::max(squares / std::max(1, count), 1e-300);
  std::vector<double> scores;
  for (size_t i = 0; i < problem.images.size(); ++i) {
    if (counts[i] < options.min_free_observations) {
      scores.push_back(-1);
      continue;
    }
    scores.push_back(gradient[i].dot(information[i].completeOrthogonalDecomposition().solve(gradient[i])) /
                     (6 * variance));
  }
  return scores;
}

}  // namespace

JointProblem WithFreeCameras(const JointProblem& problem, const JointOptions& options) {
  JointProblem free = problem;
  std::vector<int> counts(problem.images.size(), 0);
  for (const JointBody* body : {&problem.object, &problem.background}) {
    std::vector<int> of_body(problem.images.size(), 0);
    for (const JointObservation& observation : body->observations) {
      of_body[observation.image] += observation.active ? 1 : 0;
    }
    for (size_t i = 0; i < counts.size(); ++i) counts[i] = std::max(counts[i], of_body[i]);
  }
  std::vector<int> users(problem.cam_from_world.size(), 0);
  for (const JointImage& image : problem.images) ++users[image.pose];
  for (size_t i = 0; i < free.images.size(); ++i) {
    JointImage& image = free.images[i];
    if (counts[i] < options.min_free_observations || users[image.pose] <= 1) continue;
    --users[image.pose];
    free.cam_from_world.push_back(Rigid3(free.cam_from_world[image.pose]));
    image.pose = static_cast<int>(free.cam_from_world.size()) - 1;
  }
  return free;
}

JointProblem WithFreeObject(const JointProblem& problem) {
  JointProblem free = problem;
  for (size_t i = 0; i < free.images.size(); ++i) {
    free.images[i].world_from_object = problem.WorldFromObject(static_cast<int>(i));
  }
  free.free_object = true;
  return free;
}

void FillScores(const JointProblem& problem, const JointOptions& options, bool of_object, ModelTest* test) {
  const std::vector<double> scores = PoseScores(problem, options, of_object);
  double sum = 0;
  int count = 0;
  for (size_t i = 0; i < scores.size(); ++i) {
    if (scores[i] < 0) continue;
    sum += scores[i];
    ++count;
    if (scores[i] > test->worst_score) {
      test->worst_score = scores[i];
      test->worst_image = problem.images[i].name;
    }
  }
  test->score = count > 0 ? sum / count : 0;
}

void CompareModels(const JointSolved& simple, const JointSolved& general, ModelTest* test) {
  test->fitted = true;
  test->extra_parameters = general.parameters - simple.parameters;
  if (test->extra_parameters <= 0 || general.cost <= 0) return;
  const double n = general.residuals;
  const double redundancy = std::max(1.0, n - general.parameters);
  test->f_statistic = ((simple.cost - general.cost) / test->extra_parameters) / (general.cost / redundancy);
  test->bic_gain = n * std::log(simple.cost / general.cost) - test->extra_parameters * std::log(n);
  test->accepted = test->bic_gain > 0;
}

}  // namespace s2gs
