#include "tests/bench/stiffness_adjustment.h"

#include <ceres/ceres.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "sfm_split/adjust/joint_ba.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/joint_system/dense_schur.h"
#include "sfm_split/joint_system/joint_problem.h"
#include "sfm_split/joint_system/joint_system.h"
#include "tests/bench/markdown_rows.h"
#include "tests/support/random_numbers.h"
#include "tests/support/synthetic_aligned_object.h"
#include "tests/support/synthetic_models.h"
#include "tests/support/synthetic_turntable.h"

namespace s2gs {
namespace {

// --- The joint adjustment
// -----------------------------------------------------------------------------------
SyntheticTurntableOptions Capture(int steps) {
  SyntheticTurntableOptions options;
  options.stations = 3;
  options.steps = steps;
  options.step_deg = 360.0 / steps;
  options.num_object_points = 250;
  options.num_platter_points = 100;
  options.num_background_points = 400;
  options.pixel_noise = 0.5;
  return options;
}

JointProblem ProblemOf(const SyntheticTurntable& turntable) {
  AlignedScene aligned = SyntheticAlignedObject(turntable);
  aligned.background = SyntheticStaticModel(turntable);
  return MakeJointProblem(aligned);
}

// Everything but the gauge, by what free SfM is usually off.
JointProblem Perturbed(JointProblem problem, double focal_factor, uint64_t seed) {
  RandomNumbers random(seed);
  const auto vector = [&random] {
    return Eigen::Vector3d(random.Normal(), random.Normal(), random.Normal());
  };
  const Rigid3 anchor = problem.cam_from_world[static_cast<size_t>(problem.images[0].pose)];
  const double size = CameraCentre(anchor).norm();
  for (size_t pose = 0; pose < problem.cam_from_world.size(); ++pose) {
    if (static_cast<int>(pose) == problem.images[static_cast<size_t>(problem.reference)].pose) continue;
    problem.cam_from_world[pose] =
        Rigid3{Eigen::Quaterniond(ExpRotation<double>(0.003 * vector())), 0.003 * size * vector()} *
        problem.cam_from_world[pose];
  }
  for (size_t i = 0; i < problem.images.size(); ++i) {
    if (static_cast<int>(i) != problem.reference)
      problem.images[i].angle_rad += 0.3 * kDegree * random.Normal();
  }
  for (JointBody* body : {&problem.object, &problem.background}) {
    for (Eigen::Vector3d& x : body->points) x += 0.002 * size * vector();
  }
  for (Camera& camera : problem.cameras) camera.params[0] *= focal_factor;
  return problem;
}

struct Outcome {
  double condition = 0, nullity = 0;
  double focal_sigma_pct = 0, focal_error_pct = 0, focal_error_sigmas = 0;
  double angle_sigma_deg = 0, angle_error_deg = 0;
  double iterations = 0, cpu_seconds = 0, rms_px = 0;
};

// Angles after their mean offset is taken off: the reference's own error turns all others.
double AngleErrorDeg(const JointProblem& a, const JointProblem& truth) {
  std::vector<double> errors;
  double mean = 0;
  for (size_t i = 0; i < a.images.size(); ++i) {
    errors.push_back(WrapAngle(a.images[i].angle_rad - truth.images[i].angle_rad) / kDegree);
    mean += errors.back() / static_cast<double>(a.images.size());
  }
  for (double& error : errors) error = std::abs(error - mean);
  return Summarize(errors).median;
}

Outcome Adjust(const SyntheticTurntableOptions& capture, const JointOptions& options, double focal_factor) {
  constexpr uint64_t kSeeds = 3;
  std::vector<Outcome> outcomes;
  for (uint64_t seed = 1; seed <= kSeeds; ++seed) {
    SyntheticTurntableOptions own = capture;
    own.seed = seed;
    const JointProblem truth = ProblemOf(MakeSyntheticTurntable(own));
    JointProblem problem = Perturbed(truth, focal_factor, seed);
    Reporter silent;
    const double started = CpuSeconds();
    const JointReport report = AdjustJointly(options, silent, &problem);
    Outcome outcome;
    outcome.cpu_seconds = CpuSeconds() - started;
    outcome.iterations = report.iterations;
    outcome.condition = report.observability.condition;
    outcome.nullity = report.observability.nullity;
    const double focal = truth.cameras[0].params[0];
    const double error = std::abs(problem.cameras[0].params[0] - focal);
    outcome.focal_error_pct = 100 * error / focal;
    outcome.focal_sigma_pct = 100 * report.focal_sigma_px[0] / focal;
    outcome.focal_error_sigmas = report.focal_sigma_px[0] > 0 ? error / report.focal_sigma_px[0] : 0;
    outcome.angle_error_deg = AngleErrorDeg(problem, truth);
    std::vector<double> sigmas;
    for (const double sigma : report.angle_sigma_deg) {
      if (sigma > 0 && std::isfinite(sigma)) sigmas.push_back(sigma);
    }
    outcome.angle_sigma_deg = Summarize(sigmas).median;
    outcome.rms_px = report.object_rms_px;
    outcomes.push_back(outcome);
  }
  Outcome median;
  for (double Outcome::*const field :
       {&Outcome::condition, &Outcome::nullity, &Outcome::focal_sigma_pct, &Outcome::focal_error_pct,
        &Outcome::focal_error_sigmas, &Outcome::angle_sigma_deg, &Outcome::angle_error_deg,
        &Outcome::iterations, &Outcome::cpu_seconds, &Outcome::rms_px}) {
    std::vector<double> values;
    for (const Outcome& outcome : outcomes) values.push_back(outcome.*field);
    median.*field = Summarize(values).median;
  }
  return median;
}

void AdjustmentPart(int steps) {
  std::printf(
      "## The joint adjustment\n\n"
      "Synthetic scans of exact points with .5 px of noise (`tests/support/synthetic_turntable`), started "
      "from poses "
      "off by .2 degrees and .3 %%, angles by .3 degrees, points by .2 %% and a focal length by 3 %%; "
      "medians of three "
      "seeds. The condition number is that of the reduced system of the cameras' parameters, scaled to unit "
      "diagonal "
      "(`Observability::condition`).\n\n");
  struct Case {
    std::string name;
    SyntheticTurntableOptions capture;
  };
  std::vector<Case> cases;
  cases.push_back({"three stations, full turn, 1.2 x width", Capture(steps)});
  for (const double focal : {3.0, 10.0}) {
    Case one{"weak perspective: " + Number(focal) + " x width from as much farther", Capture(steps)};
    one.capture.focal_widths = focal;
    one.capture.distance *= focal / 1.2;
    cases.push_back(one);
  }
  for (const double arc : {30.0, 8.0}) {
    Case one{"short arc: " + Number(arc) + " degrees", Capture(steps)};
    one.capture.step_deg = arc / steps;
    cases.push_back(one);
  }
  Case single{"one station, full turn", Capture(steps)};
  single.capture.stations = 1;
  cases.push_back(single);
  Case worst{"one station, 30 degrees, 3 x width", single.capture};
  worst.capture.step_deg = 30.0 / steps;
  worst.capture.focal_widths = 3;
  worst.capture.distance *= 3 / 1.2;
  cases.push_back(worst);

  struct Remedy {
    std::string name;
    std::function<void(JointOptions*, double*)> apply;
  };
  const std::vector<Remedy> remedies = {
      {"as it is", [](JointOptions*, double*) {}},
      {"focal length given, exact",
       [](JointOptions* options, double* focal) {
         options->refine_focal_length = false;
         *focal = 1;
       }},
      {"focal length given, 3 % off",
       [](JointOptions* options, double*) { options->refine_focal_length = false; }},
      {"tolerance 1e-4", [](JointOptions* options, double*) { options->function_tolerance = 1e-4; }},
      {"tolerance 1e-6", [](JointOptions* options, double*) { options->function_tolerance = 1e-6; }},
      {"tolerance 1e-12", [](JointOptions* options, double*) { options->function_tolerance = 1e-12; }},
  };
  Head({"scene", "remedy", "condition", "nullity", "focal sigma [%]", "focal error [%]", "angle sigma [deg]",
        "angle error [deg]", "RMS [px]", "iterations", "CPU [s]"});
  for (const Case& one : cases) {
    for (const Remedy& remedy : remedies) {
      JointOptions options;
      options.model = JointModel::kSharedStations;
      double focal_factor = 1.03;
      remedy.apply(&options, &focal_factor);
      const Outcome o = Adjust(one.capture, options, focal_factor);
      Row({remedy.name == remedies[0].name ? "**" + one.name + "**" : "", remedy.name,
           Number(o.condition, "%.1e"), Number(o.nullity), Number(o.focal_sigma_pct),
           Number(o.focal_error_pct), Number(o.angle_sigma_deg), Number(o.angle_error_deg), Number(o.rms_px),
           Number(o.iterations), Number(o.cpu_seconds, "%.2f")});
      std::fflush(stdout);
    }
  }
}

// Largest difference of any camera-side number.
double Difference(const JointProblem& a, const JointProblem& b) {
  double worst = (a.axis - b.axis).cwiseAbs().maxCoeff();
  for (size_t i = 0; i < a.cam_from_world.size(); ++i) {
    worst = std::max(
        worst, (a.cam_from_world[i].translation - b.cam_from_world[i].translation).cwiseAbs().maxCoeff());
    worst = std::max(worst, (a.cam_from_world[i].rotation.coeffs() - b.cam_from_world[i].rotation.coeffs())
                                .cwiseAbs()
                                .maxCoeff());
  }
  for (size_t i = 0; i < a.images.size(); ++i) {
    worst = std::max(worst, std::abs(a.images[i].angle_rad - b.images[i].angle_rad));
  }
  return worst;
}

constexpr int kMostIterations = 200;
constexpr double kFunctionTolerance = 1e-10;

// One way of solving the problem.
struct Choice {
  std::string name;
  ceres::LinearSolverType solver = ceres::DENSE_SCHUR;
  ceres::PreconditionerType preconditioner = ceres::SCHUR_JACOBI;
  int threads = 1;
  bool scale_columns = true;
  ceres::TrustRegionStrategyType strategy = ceres::LEVENBERG_MARQUARDT;
  bool points_first = true;  // ordering: points are eliminated first
  bool own = false;          // SolveDenseSchur instead of Ceres
};

struct Solved {
  JointProblem problem;
  double cost = 0, iterations = 0, cpu_seconds = 0;
  bool converged = false;
};

// As joint_solve.cc sets it up, with other solvers.
Solved Solve(const JointProblem& start, const JointOptions& options, const Choice& choice) {
  Solved solved;
  solved.problem = start;
  JointSystem system(start, options, true);
  const std::unique_ptr<ceres::LossFunction> loss = MakeLoss(options);
  if (choice.own) {
    Reporter silent;
    const double started = CpuSeconds();
    const DenseSchurSummary summary =
        SolveDenseSchur(system, loss.get(), {kMostIterations, kFunctionTolerance, choice.threads}, silent);
    solved.cpu_seconds = CpuSeconds() - started;
    solved.cost = summary.cost;
    solved.iterations = summary.iterations;
    solved.converged = summary.converged;
    system.WriteBack(&solved.problem);
    return solved;
  }
  ceres::Problem::Options keep;
  keep.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  keep.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  std::deque<CeresReprojection> costs;
  ceres::Problem problem(keep);
  auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  std::map<double, std::unique_ptr<ceres::LossFunction>> scaled;  // by weight
  for (const JointSystem::Term& term : system.terms()) {
    std::unique_ptr<ceres::LossFunction>& own_loss = scaled[term.weight];
    if (!own_loss) {
      own_loss = std::make_unique<ceres::ScaledLoss>(loss.get(), term.weight, ceres::DO_NOT_TAKE_OWNERSHIP);
    }
    costs.emplace_back(term.cost);
    problem.AddResidualBlock(&costs.back(), own_loss.get(), const_cast<double* const*>(term.values.data()),
                             term.num_blocks + 1);
    ordering->AddElementToGroup(term.values[static_cast<size_t>(term.num_blocks)], 0);
  }
  for (const JointSystem::Block& block : system.blocks()) {
    if (!block.used) continue;
    ordering->AddElementToGroup(block.values, 1);
    std::vector<int> held;
    for (int k = 0; k < block.size; ++k) {
      if (std::find(block.free.begin(), block.free.end(), k) == block.free.end()) held.push_back(k);
    }
    if (block.free.empty()) {
      problem.SetParameterBlockConstant(block.values);
    } else if (!held.empty()) {
      problem.SetManifold(block.values, new ceres::SubsetManifold(block.size, held));
    }
  }
  ceres::Solver::Options solver;
  if (choice.points_first) solver.linear_solver_ordering = ordering;
  solver.linear_solver_type = choice.solver;
  solver.preconditioner_type = choice.preconditioner;
  solver.jacobi_scaling = choice.scale_columns;
  solver.trust_region_strategy_type = choice.strategy;
  solver.num_threads = choice.threads;
  solver.max_num_iterations = kMostIterations;
  solver.function_tolerance = kFunctionTolerance;
  solver.gradient_tolerance = 1e-14;
  solver.parameter_tolerance = 1e-14;
  solver.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  const double started = CpuSeconds();
  ceres::Solve(solver, &problem, &summary);
  solved.cpu_seconds = CpuSeconds() - started;
  solved.cost = summary.final_cost;
  solved.iterations = static_cast<double>(summary.iterations.size()) - 1;
  solved.converged = summary.termination_type == ceres::CONVERGENCE;
  system.WriteBack(&solved.problem);
  return solved;
}

void SolverPart(int steps) {
  std::printf(
      "\n### Solvers, preconditioners, ordering, damping\n\n"
      "The same problems by every solver of the linear system, Cauchy loss of 1 px, until the cost falls by "
      "less than "
      "1e-10 of itself or 200 iterations; one run each. The program takes the first line up to 1,000 "
      "parameters of "
      "the cameras, Ceres' sparse Schur up to 10,000, then its iterative one with the Schur complement's "
      "diagonal "
      "blocks; all lines but the first two are Ceres'. "
      "\"from the first\" is the largest difference of any pose, angle or axis from the first line, \"two "
      "runs\" that "
      "between two runs of the same.\n\n");
  Choice own{"the program's own dense Schur, Levenberg and Marquardt"};
  own.own = true;
  Choice own_two_threads = own;
  own_two_threads.name += ", two threads";
  own_two_threads.threads = 2;
  Choice dense{"dense Schur, Levenberg and Marquardt"};
  Choice two_threads = dense;
  two_threads.name += ", two threads";
  two_threads.threads = 2;
  Choice unscaled = dense;
  unscaled.name += ", columns not scaled";
  unscaled.scale_columns = false;
  Choice dogleg = dense;
  dogleg.name = "dense Schur, dogleg";
  dogleg.strategy = ceres::DOGLEG;
  Choice sparse = dense;
  sparse.name = "sparse Schur";
  sparse.solver = ceres::SPARSE_SCHUR;
  Choice cholesky = dense;
  cholesky.name = "sparse Cholesky of all, no elimination of points";
  cholesky.solver = ceres::SPARSE_NORMAL_CHOLESKY;
  cholesky.points_first = false;
  Choice iterative = dense;
  iterative.name = "iterative Schur, diagonal blocks of the complement";
  iterative.solver = ceres::ITERATIVE_SCHUR;
  Choice jacobi = iterative;
  jacobi.name = "iterative Schur, diagonal blocks of the Hessian";
  jacobi.preconditioner = ceres::JACOBI;
  Choice plain = iterative;
  plain.name = "iterative Schur, no preconditioner";
  plain.preconditioner = ceres::IDENTITY;

  struct Scene {
    std::string name;
    SyntheticTurntableOptions capture;
  };
  std::vector<Scene> scenes = {{"three stations", Capture(steps)},
                               {"weak perspective, 10 x width", Capture(steps)},
                               {"held by hand", Capture(4 * steps)}};
  scenes[1].capture.focal_widths = 10;
  scenes[1].capture.distance *= 10 / 1.2;
  scenes[2].capture.hand_held = true;
  Head({"scene", "parameters", "condition", "solver", "iterations", "converged", "cost over the first's",
        "CPU [s]", "CPU an iteration [ms]", "from the first", "two runs"});
  for (const Scene& scene : scenes) {
    const JointProblem truth = ProblemOf(MakeSyntheticTurntable(scene.capture));
    const JointProblem start = Perturbed(truth, 1.03, 1);
    JointOptions options;
    options.loss_scale_px = 1;
    options.max_dense_parameters = 5000;
    const Observability observability = AnalyzeObservability(truth, options, true, 0.5);
    Solved first;
    for (const Choice& choice : {own, own_two_threads, dense, two_threads, unscaled, dogleg, sparse, cholesky,
                                 iterative, jacobi, plain}) {
      const Solved solved = Solve(start, options, choice);
      const bool is_first = choice.name == own.name;
      if (is_first) first = solved;
      const Solved again = Solve(start, options, choice);
      Row({is_first ? "**" + scene.name + ", " + std::to_string(truth.images.size()) + " photos**" : "",
           is_first ? std::to_string(observability.num_parameters) : "",
           is_first ? Number(observability.condition, "%.1e") : "", choice.name, Number(solved.iterations),
           solved.converged ? "yes" : "no", Number(solved.cost / first.cost, "%.6f"),
           Number(solved.cpu_seconds, "%.2f"),
           Number(1e3 * solved.cpu_seconds / std::max(1.0, solved.iterations), "%.1f"),
           Number(Difference(solved.problem, first.problem), "%.1e"),
           Number(Difference(solved.problem, again.problem), "%.1e")});
      std::fflush(stdout);
    }
  }
}

}  // namespace

void PrintAdjustmentStiffness(int steps) {
  AdjustmentPart(steps);
  SolverPart(steps);
}

}  // namespace s2gs
