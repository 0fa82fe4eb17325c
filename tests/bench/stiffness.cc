// Where a problem of this program is badly conditioned, what happens there, and what helps:
//   stiffness [--steps N] > results/stiffness.md
//
// Prints the whole page. CPU seconds are of this process; iterations and errors do not depend on the machine.

#include <ceres/ceres.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <functional>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "mesh/fusion/tsdf.h"
#include "s2gs/kernel/adam.h"
#include "sfm_split/adjust/joint_ba.h"
#include "sfm_split/adjust/joint_problem.h"
#include "sfm_split/adjust/joint_system.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/base/statistics.h"
#include "tests/mesh/fusion/analytic_views.h"
#include "tests/support/random_numbers.h"
#include "tests/support/synthetic_models.h"
#include "tests/support/synthetic_turntable.h"

namespace s2gs {
namespace {

constexpr double kDegree = 3.14159265358979323846 / 180;

double CpuSeconds() { return static_cast<double>(std::clock()) / CLOCKS_PER_SEC; }

std::string Number(double value, const char* format = "%.3g") {
  char text[32];
  std::snprintf(text, sizeof text, format, value);
  return text;
}

void Row(const std::vector<std::string>& cells) {
  for (const std::string& cell : cells) std::printf("| %s ", cell.c_str());
  std::printf("|\n");
}

void Head(const std::vector<std::string>& cells) {
  Row(cells);
  Row(std::vector<std::string>(cells.size(), "---"));
}

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
  AlignedScene aligned;
  aligned.scene = turntable.scene;
  aligned.object = SyntheticObjectModel(turntable);
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

// One way of solving the problem.
struct Choice {
  std::string name;
  ceres::LinearSolverType solver = ceres::DENSE_SCHUR;
  ceres::PreconditionerType preconditioner = ceres::SCHUR_JACOBI;
  int threads = 1;
  bool scale_columns = true;
  ceres::TrustRegionStrategyType strategy = ceres::LEVENBERG_MARQUARDT;
  bool points_first = true;  // ordering: points are eliminated first
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
  ceres::Problem::Options keep;
  keep.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  keep.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ceres::Problem problem(keep);
  auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  for (const JointSystem::Term& term : system.terms()) {
    problem.AddResidualBlock(term.cost.get(), loss.get(), const_cast<double* const*>(term.values.data()),
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
  solver.max_num_iterations = 200;
  solver.function_tolerance = 1e-10;
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
      "the cameras, sparse Schur up to 10,000, then the iterative one with the Schur complement's diagonal "
      "blocks. "
      "\"from the first\" is the largest difference of any pose, angle or axis from the first line, \"two "
      "runs\" that "
      "between two runs of the same.\n\n");
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
    for (const Choice& choice :
         {dense, two_threads, unscaled, dogleg, sparse, cholesky, iterative, jacobi, plain}) {
      const Solved solved = Solve(start, options, choice);
      const bool is_first = choice.name == dense.name;
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

// --- Adam
// --------------------------------------------------------------------------------------------------- Sizes s
// from 1e-6 to 1, each started three times too large; the loss is the mean of (s / s_true - 1)^2, as a
// picture's, which sees sizes relative to what they should be. The condition number is that of its Hessian.
struct AdamOutcome {
  double first = 0, last = 0;
  double worst = 0;  // of |s / s_true - 1|
};

AdamOutcome FitSizes(double span, bool logarithmic, bool adam, double rate, int iterations) {
  constexpr int kCount = 61;
  std::vector<double> truth, x, m(kCount), v(kCount);
  for (int i = 0; i < kCount; ++i) {
    truth.push_back(std::pow(span, -static_cast<double>(i) / (kCount - 1)));
    x.push_back(logarithmic ? std::log(3 * truth.back()) : 3 * truth.back());
  }
  const auto ratio = [&](size_t i) { return (logarithmic ? std::exp(x[i]) : x[i]) / truth[i]; };
  const auto loss = [&] {
    double sum = 0;
    for (size_t i = 0; i < x.size(); ++i) sum += std::pow(ratio(i) - 1, 2) / kCount;
    return sum;
  };
  AdamOutcome outcome;
  outcome.first = loss();
  for (int t = 1; t <= iterations; ++t) {
    const AdamStep<double> step = MakeAdamStep<double>(t);
    for (size_t i = 0; i < x.size(); ++i) {
      const double by_size = 2 * (ratio(i) - 1) / truth[i] / kCount;
      const double gradient = logarithmic ? by_size * ratio(i) * truth[i] : by_size;
      if (adam) {
        UpdateByAdam(step, rate, gradient, &x[i], &m[i], &v[i]);
      } else {
        x[i] -= rate * gradient;
      }
    }
  }
  outcome.last = loss();
  for (size_t i = 0; i < x.size(); ++i) outcome.worst = std::max(outcome.worst, std::abs(ratio(i) - 1));
  return outcome;
}

void AdamPart() {
  std::printf(
      "\n## Adam with scales that span 1e6\n\n"
      "61 sizes from 1 down to 1e-6 (and, for comparison, to .1), each started three times too large; the "
      "loss sees "
      "them relative to what they should be, as a picture does. Rates are the best of powers of ten from "
      "1e-13 to 10 "
      "for each line after 1,000 iterations (for gradient descent those below 2 over the largest "
      "curvature).\n\n");
  Head({"span", "parameter", "method", "condition", "best rate", "loss", "worst size off by"});
  for (const double span : {10.0, 1e6}) {
    for (const bool logarithmic : {false, true}) {
      for (const bool adam : {false, true}) {
        AdamOutcome best;
        double best_rate = 0;
        for (double rate = 1e-13; rate < 20; rate *= 10) {
          const AdamOutcome outcome = FitSizes(span, logarithmic, adam, rate, 1000);
          if (std::isfinite(outcome.last) && (best_rate == 0 || outcome.last < best.last)) {
            best = outcome;
            best_rate = rate;
          }
        }
        Row({Number(span), logarithmic ? "log-scale" : "scale", adam ? "Adam" : "gradient descent",
             Number(logarithmic ? 1 : span * span, "%.0e"), Number(best_rate, "%.0e"), Number(best.last),
             Number(best.worst)});
      }
    }
  }
  std::printf(
      "\nA log-scale makes all sizes alike (condition 1), whatever the method; Adam alone divides by each "
      "parameter's own gradient, but its step has one length for all, which is too long for the small ones "
      "and too "
      "short for the large ones. Both together are what `s2gs/kernel` does: the step is a share of the "
      "size.\n");
}

// --- TSDF
// --------------------------------------------------------------------------------------------------- A box
// seen from a ring of cameras: its lid at the grazing angle 90 - elevation. Depths have noise along the ray,
// and the cameras are off sideways by a part of a pixel, which at grazing angles is depth.
void TsdfPart() {
  std::printf(
      "\n## TSDF at grazing angles\n\n"
      "A box of edges 1.0, seen by 40 cameras of one ring; its lid is seen at 90 degrees less the ring's "
      "height. "
      "Depths have noise of .3 %% of the distance in blocks of a pixel, cameras turned by .3 px. The "
      "amplification is "
      "1 / cos of the angle between ray and normal: how a pixel's error becomes one of depth. Lid: share of "
      "its area "
      "within one voxel of a vertex, RMS distance of those from it; sides for comparison.\n\n");
  Head({"ring [deg]", "angle on the lid [deg]", "amplification", "max_view_angle_deg", "lid covered [%]",
        "lid RMS [voxels]", "lid bias [voxels]", "sides RMS [voxels]", "CPU [s]"});
  for (const double elevation : {40.0, 15.0, 8.0, 4.0}) {
    for (const double max_angle : {60.0, 80.0, 89.0}) {
      AnalyticViewOptions options;
      options.ring_elevation_deg = elevation;
      std::vector<DepthView> views = AnalyticViews({BoxShape({0.5, 0.5, 0.5})}, options);
      RandomNumbers random(7);
      for (DepthView& view : views) {
        for (float& depth : view.depths) depth *= static_cast<float>(1 + 0.003 * random.Normal());
        const Eigen::Vector3d turn =
            0.3 / options.focal * Eigen::Vector3d(random.Normal(), random.Normal(), 0);
        view.camera.cam_from_object =
            Rigid3{Eigen::Quaterniond(ExpRotation<double>(turn)), Eigen::Vector3d::Zero()} *
            view.camera.cam_from_object;
      }
      TsdfOptions tsdf;
      tsdf.backend = TsdfBackend::kCpu;
      tsdf.voxel_size = 0.02;
      tsdf.max_view_angle_deg = max_angle;
      TsdfSummary summary;
      Reporter silent;
      const double started = CpuSeconds();
      TriangleMesh mesh;
      try {
        mesh = MeshFromDepthMaps(DepthViewList(std::move(views)), tsdf, silent, &summary);
      } catch (const UserError&) {
        // Nothing is seen well enough: an empty mesh.
      }
      const double seconds = CpuSeconds() - started;
      std::vector<double> lid, sides;
      std::set<std::pair<int, int>> cells;
      for (const Eigen::Vector3f& vertex : mesh.vertices) {
        const Eigen::Vector3d x = vertex.cast<double>();
        // Away from the edges, where distances belong to one face.
        if (x.z() > 0.3 && x.head<2>().cwiseAbs().maxCoeff() < 0.44) {
          lid.push_back((x.z() - 0.5) / tsdf.voxel_size);
          cells.emplace(static_cast<int>(std::floor(x.x() / tsdf.voxel_size)),
                        static_cast<int>(std::floor(x.y() / tsdf.voxel_size)));
        } else if (std::abs(x.z()) < 0.4 && std::abs(x.y()) < 0.4) {
          sides.push_back((std::abs(x.x()) - 0.5) / tsdf.voxel_size);
        }
      }
      const auto rms = [](const std::vector<double>& values) {
        double sum = 0;
        for (const double value : values) sum += value * value;
        return values.empty() ? NAN : std::sqrt(sum / static_cast<double>(values.size()));
      };
      Row({Number(elevation), Number(90 - elevation), Number(1 / std::cos((90 - elevation) * kDegree)),
           Number(max_angle), Number(100 * static_cast<double>(cells.size()) / (44 * 44.0)),
           lid.empty() ? "-" : Number(rms(lid)), lid.empty() ? "-" : Number(Summarize(lid).mean),
           Number(rms(sides)), Number(seconds, "%.2f")});
      std::fflush(stdout);
    }
  }
}

}  // namespace
}  // namespace s2gs

int main(int argc, char** argv) {
  int steps = 16;
  if (argc == 3 && std::string(argv[1]) == "--steps") steps = std::max(4, std::atoi(argv[2]));
  std::printf(
      "# Where problems are badly conditioned\n\n"
      "Generated by `BUILD/tests/stiffness > tests/bench/results/stiffness.md`: what happens where a problem "
      "is badly "
      "conditioned, what helps, and what that costs. Iterations and errors are the same on every machine, "
      "CPU seconds "
      "are not.\n\n");
  s2gs::AdjustmentPart(steps);
  s2gs::SolverPart(steps);
  s2gs::AdamPart();
  s2gs::TsdfPart();
  return EXIT_SUCCESS;
}
