#include "sfm_split/joint_system/joint_solve.h"

#include <ceres/ceres.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <deque>
#include <map>
#include <memory>
#include <unordered_map>
#include <unordered_set>
#include <vector>

#include "sfm_split/joint_system/dense_schur.h"
#include "sfm_split/joint_system/joint_system.h"

namespace s2gs {
namespace {

constexpr int kMaxDenseParameters = 1000;  // a matrix of 8 MB
// More: the cameras' equations are not formed but solved iteratively.
constexpr int kMaxSparseParameters = 10000;

class ReportingCallback : public ceres::IterationCallback {
 public:
  ReportingCallback(Reporter& reporter, int max_iterations) : reporter_(reporter), max_(max_iterations) {}

  ceres::CallbackReturnType operator()(const ceres::IterationSummary& summary) override {
    reporter_.Progress("joint adjustment", summary.iteration, max_);
    stopped_ = reporter_.StopRequested();
    return stopped_ ? ceres::SOLVER_ABORT : ceres::SOLVER_CONTINUE;
  }
  bool stopped() const { return stopped_; }

 private:
  Reporter& reporter_;
  int max_;
  bool stopped_ = false;
};

// A copy of a system's parameters in one piece, in its own order. Ceres orders parameters by their addresses,
// and only inside one piece these are in the same order in every run: sums, and so the last digits of
// results, depend on it.
class OrderedParameters {
 public:
  explicit OrderedParameters(const JointSystem& system) {
    size_t size = 0;
    const auto place = [&](double* source, int count) {
      if (!offset_of_.emplace(source, size).second) return;
      sources_.push_back({source, size, static_cast<size_t>(count)});
      size += static_cast<size_t>(count);
    };
    sources_.reserve(system.blocks().size() + system.terms().size());
    for (const JointSystem::Block& block : system.blocks()) place(block.values, block.size);
    for (const JointSystem::Term& term : system.terms()) place(term.values[term.num_blocks], 3);
    values_.resize(size);
    for (const Source& source : sources_) {
      std::copy_n(source.values, source.count, values_.begin() + static_cast<std::ptrdiff_t>(source.offset));
    }
  }

  double* At(const double* source) { return values_.data() + offset_of_.at(source); }

  /// Back to where they came from.
  void WriteBack() const {
    for (const Source& source : sources_) {
      std::copy_n(values_.begin() + static_cast<std::ptrdiff_t>(source.offset), source.count, source.values);
    }
  }

 private:
  struct Source {
    double* values;
    size_t offset;
    size_t count;
  };

  std::unordered_map<const double*, size_t> offset_of_;
  std::vector<Source> sources_;
  std::vector<double> values_;
};

class PriorCost : public ceres::CostFunction {
 public:
  PriorCost(const PriorTerm& term, const JointSystem& system) : term_(term) {
    set_num_residuals(1);
    for (const PriorTerm::Part& part : term.parts) {
      if (std::find(blocks_.begin(), blocks_.end(), part.block) == blocks_.end()) {
        blocks_.push_back(part.block);
        sizes_.push_back(system.blocks()[part.block].size);
        mutable_parameter_block_sizes()->push_back(sizes_.back());
      }
      place_.push_back(
          static_cast<size_t>(std::find(blocks_.begin(), blocks_.end(), part.block) - blocks_.begin()));
    }
  }
  const std::vector<int>& blocks() const { return blocks_; }

  bool Evaluate(const double* const* parameters, double* residual, double** jacobians) const override {
    std::vector<double> values;
    for (size_t k = 0; k < place_.size(); ++k) values.push_back(parameters[place_[k]][term_.parts[k].value]);
    std::vector<double> derivatives;
    residual[0] = term_.Residual(values, &derivatives);
    if (jacobians == nullptr) return true;
    for (size_t b = 0; b < blocks_.size(); ++b) {
      if (jacobians[b] != nullptr) std::fill_n(jacobians[b], sizes_[b], 0.0);
    }
    for (size_t k = 0; k < place_.size(); ++k) {
      if (jacobians[place_[k]] != nullptr) jacobians[place_[k]][term_.parts[k].value] += derivatives[k];
    }
    return true;
  }

 private:
  PriorTerm term_;
  std::vector<int> blocks_;
  std::vector<int> sizes_;
  std::vector<size_t> place_;  // of each part's block
};

void SolveByCeres(const JointSystem& system, int camera_parameters, const JointOptions& options,
                  double function_tolerance, Reporter& reporter, JointSolved* solved) {
  OrderedParameters parameters(system);
  const std::unique_ptr<ceres::LossFunction> loss = MakeLoss(options);
  std::map<double, std::unique_ptr<ceres::LossFunction>> scaled_losses;  // by weight
  std::deque<CeresReprojection> costs;
  std::vector<std::unique_ptr<PriorCost>> priors;
  ceres::Problem::Options problem_options;
  problem_options.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  problem_options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  problem_options.disable_all_safety_checks = true;
  ceres::Problem ceres_problem(problem_options);
  auto* ordering = new ceres::ParameterBlockOrdering;
  for (const JointSystem::Block& block : system.blocks()) {
    if (!block.used) continue;
    double* const values = parameters.At(block.values);
    ceres_problem.AddParameterBlock(values, block.size);
    ordering->AddElementToGroup(values, 1);
    if (block.free.empty()) {
      ceres_problem.SetParameterBlockConstant(values);
    } else if (static_cast<int>(block.free.size()) < block.size) {
      std::vector<int> held;
      for (int k = 0; k < block.size; ++k) {
        if (std::find(block.free.begin(), block.free.end(), k) == block.free.end()) held.push_back(k);
      }
      ceres_problem.SetManifold(values, new ceres::SubsetManifold(block.size, held));
    }
  }
  for (const JointSystem::Term& term : system.terms()) {
    std::array<double*, 5> values{};
    for (int k = 0; k <= term.num_blocks; ++k) values[k] = parameters.At(term.values[k]);
    double* const point = values[term.num_blocks];
    if (!ceres_problem.HasParameterBlock(point)) {
      ceres_problem.AddParameterBlock(point, 3);
      ordering->AddElementToGroup(point, 0);
    }
    ceres::LossFunction* term_loss = loss.get();
    if (term.weight != 1) {
      std::unique_ptr<ceres::LossFunction>& scaled = scaled_losses[term.weight];
      if (!scaled) {
        scaled = std::make_unique<ceres::ScaledLoss>(loss.get(), term.weight, ceres::DO_NOT_TAKE_OWNERSHIP);
      }
      term_loss = scaled.get();
    }
    costs.emplace_back(term.cost);
    ceres_problem.AddResidualBlock(&costs.back(), term_loss, values.data(), term.num_blocks + 1);
  }
  for (const PriorTerm& term : system.priors()) {
    priors.push_back(std::make_unique<PriorCost>(term, system));
    std::vector<double*> values;
    for (const int block : priors.back()->blocks())
      values.push_back(parameters.At(system.blocks()[block].values));
    ceres_problem.AddResidualBlock(priors.back().get(), nullptr, values);
  }
  ceres::Solver::Options solver;
  solver.linear_solver_ordering.reset(ordering);
  if (camera_parameters <= kMaxSparseParameters) {
    solver.linear_solver_type = ceres::SPARSE_SCHUR;
  } else {
    solver.linear_solver_type = ceres::ITERATIVE_SCHUR;
    solver.preconditioner_type = ceres::SCHUR_JACOBI;
  }
  // Its sums are in the order in which threads come.
  solver.num_threads = std::max(1, options.num_threads);
  solver.max_num_iterations = options.max_iterations;
  solver.function_tolerance = function_tolerance;
  solver.gradient_tolerance = 1e-14;
  solver.parameter_tolerance = 1e-14;
  solver.logging_type = ceres::SILENT;
  solver.minimizer_progress_to_stdout = false;
  ReportingCallback callback(reporter, options.max_iterations);
  solver.callbacks.push_back(&callback);
  ceres::Solver::Summary summary;
  ceres::Solve(solver, &ceres_problem, &summary);
  if (callback.stopped()) throw Interrupted();
  solved->cost = 2 * summary.final_cost;
  solved->iterations = static_cast<int>(summary.iterations.size()) - 1;
  solved->converged = summary.termination_type == ceres::CONVERGENCE;
  solved->linear_solver = ceres::LinearSolverTypeToString(solver.linear_solver_type);
  if (summary.IsSolutionUsable()) parameters.WriteBack();
}

}  // namespace

JointSolved SolveSystem(const JointSystem& system, const JointOptions& options, double function_tolerance,
                        Reporter& reporter) {
  JointSolved solved;
  int camera_parameters = 0;
  for (const JointSystem::Block& block : system.blocks()) {
    if (block.used) camera_parameters += static_cast<int>(block.free.size());
  }
  double weights = 0;
  std::unordered_set<const double*> points;
  for (const JointSystem::Term& term : system.terms()) {
    weights += term.weight;
    points.insert(term.values[static_cast<size_t>(term.num_blocks)]);
  }
  solved.parameters = camera_parameters + 3 * static_cast<int>(points.size());
  solved.residuals = static_cast<int>(std::lround(2 * weights));
  if (system.terms().empty()) return solved;
  if (camera_parameters <= kMaxDenseParameters) {
    DenseSchurOptions dense;
    dense.max_iterations = options.max_iterations;
    dense.function_tolerance = function_tolerance;
    dense.num_threads = options.num_threads;
    const DenseSchurSummary summary = SolveDenseSchur(system, MakeLoss(options).get(), dense, reporter);
    solved.cost = 2 * summary.cost;
    solved.iterations = summary.iterations;
    solved.converged = summary.converged;
    solved.linear_solver = "DENSE_SCHUR";
  } else {
    SolveByCeres(system, camera_parameters, options, function_tolerance, reporter, &solved);
  }
  return solved;
}

JointSolved SolveJointOnce(const JointOptions& options, double function_tolerance, Reporter& reporter,
                           JointProblem* problem) {
  const JointSystem system(*problem, options, true);
  JointSolved solved = SolveSystem(system, options, function_tolerance, reporter);
  system.WriteBack(problem);
  return solved;
}

}  // namespace s2gs
