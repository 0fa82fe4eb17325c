#include <ceres/ceres.h>
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <deque>
#include <memory>
#include <vector>

#include "sfm_split/adjust/joint_ba.h"
#include "sfm_split/joint_system/dense_schur.h"
#include "sfm_split/joint_system/joint_system.h"
#include "tests/sfm_split/adjust/joint_scene.h"

namespace s2gs {
namespace {

// Terms, losses and what is held of a system as a problem of Ceres, which moves the system's own values.
void FillCeres(const JointSystem& system, ceres::LossFunction* loss, ceres::Problem* problem,
               std::deque<CeresReprojection>* costs, std::vector<const double*>* free_blocks) {
  for (const JointSystem::Term& term : system.terms()) {
    ceres::LossFunction* scaled = nullptr;  // the problem's own
    if (loss != nullptr) scaled = new ceres::ScaledLoss(loss, term.weight, ceres::DO_NOT_TAKE_OWNERSHIP);
    costs->emplace_back(term.cost);
    problem->AddResidualBlock(&costs->back(), scaled, term.values.data(), term.num_blocks + 1);
  }
  for (const JointSystem::Block& block : system.blocks()) {
    if (!block.used) continue;
    std::vector<int> held;
    for (int k = 0; k < block.size; ++k) {
      if (std::find(block.free.begin(), block.free.end(), k) == block.free.end()) held.push_back(k);
    }
    if (block.free.empty()) {
      problem->SetParameterBlockConstant(block.values);
    } else {
      if (!held.empty()) problem->SetManifold(block.values, new ceres::SubsetManifold(block.size, held));
      free_blocks->push_back(block.values);
    }
  }
}

// The same minimum as Ceres' own solver, by QR of the whole Jacobian, and the same bits for any number of
// threads.
TEST(JointBa, DenseSchurEndsWhereCeresDoes) {
  for (const JointLoss kind : {JointLoss::kSquared, JointLoss::kHuber, JointLoss::kCauchy}) {
    JointScene scene;
    scene.steps = 5;
    scene.step_deg = 40;
    scene.object_points = 40;
    scene.background_points = 30;
    scene.noise_px = 0.5;
    scene.outliers = 0.02;
    scene.Build(8);
    scene.Perturb(0.005, 1.02, 4);
    for (size_t k = 0; k < scene.start.object.observations.size(); k += 3)
      scene.start.object.observations[k].weight = 0.5;
    JointOptions options;
    options.loss = kind;
    options.loss_scale_px = 1;
    FilterObservations(options, 1e3, &scene.start);
    const std::unique_ptr<ceres::LossFunction> loss =
        kind == JointLoss::kSquared ? std::make_unique<ceres::TrivialLoss>() : MakeLoss(options);

    const JointSystem theirs(scene.start, options, true);
    ceres::Problem::Options keep;
    keep.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
    std::deque<CeresReprojection> costs;
    ceres::Problem problem(keep);
    std::vector<const double*> free_blocks;
    FillCeres(theirs, loss.get(), &problem, &costs, &free_blocks);
    ceres::Solver::Options solver;
    solver.linear_solver_type = ceres::DENSE_QR;
    solver.function_tolerance = 1e-14;
    solver.gradient_tolerance = 1e-14;
    solver.parameter_tolerance = 1e-14;
    solver.max_num_iterations = 200;
    solver.logging_type = ceres::SILENT;
    ceres::Solver::Summary summary;
    ceres::Solve(solver, &problem, &summary);
    JointProblem expected = scene.start;
    theirs.WriteBack(&expected);

    DenseSchurOptions ours;
    ours.function_tolerance = 1e-14;
    ours.max_iterations = 200;
    JointProblem first;
    for (const int threads : {1, 2, 5}) {
      ours.num_threads = threads;
      const JointSystem system(scene.start, options, true);
      Reporter silent;
      const DenseSchurSummary found = SolveDenseSchur(system, MakeLoss(options).get(), ours, silent);
      EXPECT_TRUE(found.converged);
      EXPECT_LT(std::abs(found.cost - summary.final_cost), 1e-9 * summary.final_cost);  // measured 2e-13
      JointProblem result = scene.start;
      system.WriteBack(&result);
      EXPECT_LT(LargestDifference(result, expected), 1e-6);  // measured 1e-8
      if (threads == 1) first = result;
      EXPECT_EQ(LargestDifference(result, first), 0);
      EXPECT_EQ(result.object.points, first.object.points);
    }
    EXPECT_GT(LargestDifference(first, scene.start), 1e-3);
  }
}

// The covariance of the reduced system against Ceres', by dense decomposition of the whole Jacobian.
TEST(JointBa, CovarianceEqualsCeres) {
  JointScene scene;
  scene.steps = 5;
  scene.step_deg = 40;
  scene.object_points = 30;
  scene.background_points = 30;
  scene.Build(8);
  JointOptions options;
  options.loss = JointLoss::kSquared;
  FilterObservations(options, 10, &scene.truth);
  const Observability ours = AnalyzeObservability(scene.truth, options, true, 1);
  ASSERT_TRUE(ours.computed);
  ASSERT_EQ(ours.nullity, 0);
  const JointSystem system(scene.truth, options, true);
  ceres::Problem::Options keep;
  keep.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  std::deque<CeresReprojection> costs;
  ceres::Problem problem(keep);
  std::vector<const double*> blocks;
  FillCeres(system, nullptr, &problem, &costs, &blocks);
  ceres::Covariance::Options covariance_options;
  covariance_options.algorithm_type = ceres::DENSE_SVD;
  covariance_options.null_space_rank = 0;
  ceres::Covariance covariance(covariance_options);
  ASSERT_TRUE(covariance.Compute(blocks, &problem));
  Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> theirs(ours.covariance.rows(),
                                                                                ours.covariance.cols());
  ASSERT_TRUE(covariance.GetCovarianceMatrixInTangentSpace(blocks, theirs.data()));
  const Eigen::VectorXd sigma = theirs.diagonal().cwiseSqrt();
  const Eigen::MatrixXd error =
      sigma.cwiseInverse().asDiagonal() * (theirs - ours.covariance) * sigma.cwiseInverse().asDiagonal();
  EXPECT_LT(error.cwiseAbs().maxCoeff(), 1e-6);  // measured 3e-9
}

}  // namespace
}  // namespace s2gs
