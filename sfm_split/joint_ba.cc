#include "sfm_split/joint_ba.h"

#include <ceres/ceres.h>

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <limits>
#include <map>
#include <memory>
#include <set>
#include <thread>
#include <unordered_map>
#include <utility>
#include <vector>

#include "sfm_split/joint_system.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::VectorXd;

constexpr double kPi = 3.14159265358979323846;
constexpr double kMadToSigma = 1.4826;
constexpr double kScoreWorthFitting = 1.5;
constexpr double kCoarseTolerance = 1e-6;  // of rounds that are followed by another
constexpr double kInfinity = std::numeric_limits<double>::infinity();

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

struct Solved {
  double cost = 0;     // sum of the loss over observations (not halved)
  int parameters = 0;  // free ones, points included
  int residuals = 0;
  int iterations = 0;
  bool converged = false;
  std::string linear_solver;
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

// Adjusts a problem's active observations once.
Solved SolveOnce(const JointOptions& options, double function_tolerance, Reporter& reporter,
                 JointProblem* problem) {
  Solved solved;
  JointSystem system(*problem, options, true);
  OrderedParameters parameters(system);
  const std::unique_ptr<ceres::LossFunction> loss = MakeLoss(options);
  std::map<double, std::unique_ptr<ceres::LossFunction>> scaled_losses;  // by weight
  ceres::Problem::Options problem_options;
  problem_options.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  problem_options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  problem_options.disable_all_safety_checks = true;
  ceres::Problem ceres_problem(problem_options);
  auto* ordering = new ceres::ParameterBlockOrdering;
  int camera_parameters = 0;
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
    camera_parameters += static_cast<int>(block.free.size());
  }
  int points = 0;
  for (const JointSystem::Term& term : system.terms()) {
    std::array<double*, 5> values{};
    for (int k = 0; k <= term.num_blocks; ++k) values[k] = parameters.At(term.values[k]);
    double* const point = values[term.num_blocks];
    if (!ceres_problem.HasParameterBlock(point)) {
      ceres_problem.AddParameterBlock(point, 3);
      ordering->AddElementToGroup(point, 0);
      ++points;
    }
    ceres::LossFunction* term_loss = loss.get();
    if (term.weight != 1) {
      std::unique_ptr<ceres::LossFunction>& scaled = scaled_losses[term.weight];
      if (!scaled) {
        scaled = std::make_unique<ceres::ScaledLoss>(loss.get(), term.weight, ceres::DO_NOT_TAKE_OWNERSHIP);
      }
      term_loss = scaled.get();
    }
    ceres_problem.AddResidualBlock(term.cost.get(), term_loss, values.data(), term.num_blocks + 1);
  }
  solved.parameters = camera_parameters + 3 * points;
  double weights = 0;
  for (const JointSystem::Term& term : system.terms()) weights += term.weight;
  solved.residuals = static_cast<int>(std::lround(2 * weights));
  ceres::Solver::Options solver;
  solver.linear_solver_ordering.reset(ordering);
  if (system.terms().empty()) return solved;

  if (camera_parameters <= 1000) {
    solver.linear_solver_type = ceres::DENSE_SCHUR;
  } else if (camera_parameters <= 10000) {
    solver.linear_solver_type = ceres::SPARSE_SCHUR;
  } else {
    solver.linear_solver_type = ceres::ITERATIVE_SCHUR;
    solver.preconditioner_type = ceres::SCHUR_JACOBI;
  }
  solver.num_threads = options.num_threads > 0
                           ? options.num_threads
                           : static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
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
  solved.cost = 2 * summary.final_cost;
  solved.iterations = static_cast<int>(summary.iterations.size()) - 1;
  solved.converged = summary.termination_type == ceres::CONVERGENCE;
  solved.linear_solver = ceres::LinearSolverTypeToString(solver.linear_solver_type);
  if (!summary.IsSolutionUsable()) return solved;
  parameters.WriteBack();
  system.WriteBack(problem);
  return solved;
}

// Residuals of active observations; observations behind the camera give the cost's constant error.
struct Residuals {
  double object_squares = 0;
  double background_squares = 0;
  int object = 0;
  int background = 0;
  std::vector<double> coordinates;

  double Rms() const {
    return std::sqrt((object_squares + background_squares) / std::max(1, object + background));
  }
};

Residuals MeasureResiduals(const JointProblem& problem) {
  Residuals all;
  for (const bool of_object : {true, false}) {
    const JointBody& body = of_object ? problem.object : problem.background;
    for (const JointObservation& observation : body.observations) {
      if (!observation.active) continue;
      const JointImage& image = problem.images[observation.image];
      Vector3d x = body.points[observation.point];
      if (of_object) x = problem.WorldFromObject(observation.image) * x;
      Vector2d xy;
      Vector2d residual = Vector2d::Constant(ReprojectionCost::kBehindCameraError);
      const Camera& camera = problem.cameras[image.camera];
      if (ProjectWithJacobians(camera.model, camera.params.data(), problem.cam_from_world[image.pose] * x,
                               &xy, nullptr, nullptr)) {
        residual = xy - observation.xy;
      }
      (of_object ? all.object_squares : all.background_squares) += residual.squaredNorm();
      ++(of_object ? all.object : all.background);
      all.coordinates.push_back(residual.x());
      all.coordinates.push_back(residual.y());
    }
  }
  return all;
}

double RobustSigma(std::vector<double> residuals, int parameters) {
  if (residuals.empty()) return 0;
  for (double& r : residuals) r = std::abs(r);
  const auto middle = residuals.begin() + static_cast<std::ptrdiff_t>(residuals.size() / 2);
  std::nth_element(residuals.begin(), middle, residuals.end());
  const double count = static_cast<double>(residuals.size());
  return kMadToSigma * *middle * std::sqrt(count / std::max(1.0, count - parameters));
}

// --- Which model
// ----------------------------------------------------------------------------------------------

// Score statistic of each image for a camera pose of its own, from one body's observations with the structure
// held: g^T (s^2 sum J^T J)^-1 g / 6, with g the gradient of the robust cost. Its mean is 1 under the simple
// model (a little less, since other parameters are fitted); images with too few observations give -1.
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
    term.cost->Evaluate(term.values.data(), residual.data(), jacobians.data());
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

void FillScores(const JointProblem& problem, const std::vector<double>& scores, ModelTest* test) {
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

// Every image with enough of either body gets a camera pose of its own: the object tells all of it but its
// turn about the axis.
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

// Takes the general model when the Bayesian information criterion does.
void Compare(const Solved& simple, const Solved& general, ModelTest* test) {
  test->fitted = true;
  test->extra_parameters = general.parameters - simple.parameters;
  if (test->extra_parameters <= 0 || general.cost <= 0) return;
  const double n = general.residuals;
  const double redundancy = std::max(1.0, n - general.parameters);
  test->f_statistic = ((simple.cost - general.cost) / test->extra_parameters) / (general.cost / redundancy);
  test->bic_gain = n * std::log(simple.cost / general.cost) - test->extra_parameters * std::log(n);
  test->accepted = test->bic_gain > 0;
}

// --- What is known how well
// -----------------------------------------------------------------------------------

void FillSigmas(const JointProblem& problem, const JointOptions& options, JointReport* report) {
  const Observability& observability = report->observability;
  if (!observability.computed) return;
  std::map<std::pair<int, int>, int> index_of;
  for (size_t k = 0; k < observability.parameters.size(); ++k) {
    index_of[observability.parameters[k]] = static_cast<int>(k);
  }
  const std::array<const Eigen::MatrixXd*, 3> covariances = {
      &observability.covariance, &observability.robust_covariance, &observability.regional_covariance};
  const JointSystem system(problem, options, true);
  const auto variance = [&](int block, int value) {
    const auto found = index_of.find({block, value});
    if (found == index_of.end()) return 0.0;
    double largest = 0;
    for (const Eigen::MatrixXd* covariance : covariances)
      largest = std::max(largest, (*covariance)(found->second, found->second));
    return largest;
  };
  for (size_t c = 0; c < problem.cameras.size(); ++c) {
    report->focal_sigma_px.push_back(std::sqrt(variance(system.IntrinsicsBlock(static_cast<int>(c)), 0)));
  }
  if (problem.free_object) return;
  for (size_t i = 0; i < problem.images.size(); ++i) {
    const double sigma = std::sqrt(variance(system.AngleBlock(static_cast<int>(i)), 0)) * 180 / kPi;
    report->angle_sigma_deg.push_back(system.IsTied(problem.images[i].pose) ? sigma : kInfinity);
  }
  if (!system.blocks()[system.AxisBlock()].used) return;
  const auto worst = [](const Eigen::Matrix2d& covariance) {
    return std::sqrt(
        std::max(0.0, Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(covariance).eigenvalues()(1)));
  };
  report->axis_direction_sigma_deg = report->axis_point_sigma = 0;
  for (const Eigen::MatrixXd* covariance : covariances) {
    Eigen::Matrix4d axis = Eigen::Matrix4d::Zero();
    for (int a = 0; a < 4; ++a) {
      for (int b = 0; b < 4; ++b) {
        const auto first = index_of.find({system.AxisBlock(), a});
        const auto second = index_of.find({system.AxisBlock(), b});
        if (first == index_of.end() || second == index_of.end()) continue;
        axis(a, b) = (*covariance)(first->second, second->second);
      }
    }
    report->axis_direction_sigma_deg =
        std::max(report->axis_direction_sigma_deg, worst(axis.topLeftCorner<2, 2>()) * 180 / kPi);
    report->axis_point_sigma = std::max(report->axis_point_sigma, worst(axis.bottomRightCorner<2, 2>()));
  }

  // log(scale) = log(distance of the anchor from the axis) - log(distance of the anchor from the station
  // farthest from it), by differences over the parameters that it depends on.
  std::vector<bool> has_background(problem.cam_from_world.size(), false);
  for (const JointObservation& observation : problem.background.observations) {
    if (observation.active) has_background[problem.images[observation.image].pose] = true;
  }
  report->scale_sigma_rel = kInfinity;
  if (!has_background[system.anchor()]) return;
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
  if (farthest < 0) return;
  at.tail<3>() = system.CentreOfPose(farthest);
  const double distance = problem.AxisDirection().cross(anchor - problem.AxisPoint()).norm();
  if (distance <= 0 || baseline <= 1e-9 * distance) return;
  VectorXd gradient = VectorXd::Zero(observability.covariance.rows());
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
  report->scale_sigma_rel = std::sqrt(scale_variance);
}

// The loss' scale that the residuals of a problem ask for.
double LossScaleOf(const JointProblem& problem) {
  std::set<std::pair<bool, int>> points;
  for (const bool of_object : {true, false}) {
    for (const JointObservation& observation :
         of_object ? problem.object.observations : problem.background.observations) {
      if (observation.active) points.emplace(of_object, observation.point);
    }
  }
  return LossScalePx(RobustSigma(MeasureResiduals(problem).coordinates, 3 * static_cast<int>(points.size())));
}

// Alternates adjusting and taking observations out until nothing more goes.
// \param options  its loss' scale follows the residuals where `fit_loss`.
Solved SolveInRounds(bool fit_loss, Reporter& reporter, JointOptions* fitted_options, JointProblem* problem,
                     JointReport* report) {
  JointOptions& options = *fitted_options;
  Solved solved;
  for (int round = 0; round < options.max_rounds; ++round) {
    if (fit_loss) options.loss_scale_px = LossScaleOf(*problem);
    const bool may_be_last = round + 1 == options.max_rounds;
    solved = SolveOnce(
        options,
        may_be_last ? options.function_tolerance : std::max(kCoarseTolerance, options.function_tolerance),
        reporter, problem);
    report->iterations += solved.iterations;
    if (may_be_last) break;
    const FilterCounts counts = FilterObservations(options, options.max_reprojection_error_px, problem);
    report->removed_observations += counts.observations;
    report->undetermined_points += counts.points;
    const bool settled = counts.observations <= 1e-4 * solved.residuals && counts.points == 0;
    if (settled) {
      if (fit_loss) options.loss_scale_px = LossScaleOf(*problem);
      solved = SolveOnce(options, options.function_tolerance, reporter, problem);
      report->iterations += solved.iterations;
      break;
    }
  }
  return solved;
}

}  // namespace

const char* JointModelName(JointModel model) {
  switch (model) {
    case JointModel::kAuto:
      return "auto";
    case JointModel::kSharedStations:
      return "shared stations";
    case JointModel::kFreeCameras:
      return "free cameras";
    case JointModel::kFreeObject:
      return "free object";
  }
  return "";
}

OptionCheck JointOptions::Check() const {
  const auto fault = [](const char* field, double value, const char* bound) {
    return OptionFault{field, std::to_string(value), bound};
  };
  if (!(loss_scale_px >= 0)) return fault("loss_scale_px", loss_scale_px, "loss_scale_px >= 0");
  if (!(max_reprojection_error_px > 0)) {
    return fault("max_reprojection_error_px", max_reprojection_error_px, "max_reprojection_error_px > 0");
  }
  if (!(min_triangulation_deg >= 0)) {
    return fault("min_triangulation_deg", min_triangulation_deg, "min_triangulation_deg >= 0");
  }
  if (max_rounds < 1) return fault("max_rounds", max_rounds, "max_rounds >= 1");
  if (max_iterations < 1) return fault("max_iterations", max_iterations, "max_iterations >= 1");
  if (!(function_tolerance >= 0))
    return fault("function_tolerance", function_tolerance, "function_tolerance >= 0");
  if (min_free_observations < 3) {
    return fault("min_free_observations", min_free_observations, "min_free_observations >= 3");
  }
  if (num_threads < 0) return fault("num_threads", num_threads, "num_threads >= 0");
  return std::nullopt;
}

FilterCounts FilterObservations(const JointOptions& options, double max_error_px, JointProblem* problem) {
  FilterCounts counts;
  const double least_cosine = std::cos(options.min_triangulation_deg * kPi / 180);
  for (const bool of_object : {true, false}) {
    JointBody& body = of_object ? problem->object : problem->background;
    std::vector<std::vector<size_t>> of_point(body.points.size());
    for (size_t k = 0; k < body.observations.size(); ++k) {
      JointObservation& observation = body.observations[k];
      if (!observation.active) continue;
      const JointImage& image = problem->images[observation.image];
      Vector3d x = body.points[observation.point];
      if (of_object) x = problem->WorldFromObject(observation.image) * x;
      const Camera& camera = problem->cameras[image.camera];
      Vector2d xy;
      if (ProjectWithJacobians(camera.model, camera.params.data(), problem->cam_from_world[image.pose] * x,
                               &xy, nullptr, nullptr) &&
          (xy - observation.xy).squaredNorm() <= max_error_px * max_error_px) {
        of_point[observation.point].push_back(k);
      } else {
        observation.active = false;
        ++counts.observations;
      }
    }
    std::vector<Vector3d> rays;
    for (size_t p = 0; p < body.points.size(); ++p) {
      if (of_point[p].empty()) continue;
      rays.clear();
      for (const size_t k : of_point[p]) {
        const JointObservation& observation = body.observations[k];
        const Vector3d centre =
            CameraCentre(problem->cam_from_world[problem->images[observation.image].pose]);
        const Vector3d in_body =
            of_object ? problem->WorldFromObject(observation.image).Inverse() * centre : centre;
        rays.push_back((in_body - body.points[p]).normalized());
      }
      bool determined = false;
      for (size_t a = 1; a < rays.size() && !determined; ++a) {
        for (size_t b = 0; b < a && !determined; ++b) determined = rays[a].dot(rays[b]) < least_cosine;
      }
      if (determined) continue;
      ++counts.points;
      for (const size_t k : of_point[p]) body.observations[k].active = false;
    }
  }
  return counts;
}

JointReport AdjustJointly(const JointOptions& asked, Reporter& reporter, JointProblem* problem) {
  S2GS_INVARIANT(!asked.Check());
  JointOptions options = asked;
  const bool fit_loss = asked.loss_scale_px == 0;
  const auto start = std::chrono::steady_clock::now();
  JointReport report;
  JointProblem working = *problem;
  // Gross errors stay for the robust loss; points without depth would only slow it down.
  report.undetermined_points = FilterObservations(options, kInfinity, &working).points;
  report.initial_rms_px = MeasureResiduals(working).Rms();
  report.model = JointModel::kSharedStations;
  if (working.free_object) {
    report.model = JointModel::kFreeObject;
  } else if (options.model == JointModel::kFreeCameras) {
    working = WithFreeCameras(working, options);
    report.model = JointModel::kFreeCameras;
  } else if (options.model == JointModel::kFreeObject) {
    working = WithFreeObject(working);
    report.model = JointModel::kFreeObject;
  }
  Solved solved = SolveInRounds(fit_loss, reporter, &options, &working, &report);

  if (options.model == JointModel::kAuto && !working.free_object) {
    for (const JointModel general : {JointModel::kFreeCameras, JointModel::kFreeObject}) {
      ModelTest test;
      test.simple = report.model;
      test.general = general;
      const bool of_object = general == JointModel::kFreeObject;
      FillScores(working, PoseScores(working, options, of_object), &test);
      if (test.score > kScoreWorthFitting) {
        JointProblem candidate = of_object ? WithFreeObject(working) : WithFreeCameras(working, options);
        const Solved general_solved = SolveOnce(options, options.function_tolerance, reporter, &candidate);
        report.iterations += general_solved.iterations;
        Compare(solved, general_solved, &test);
        if (test.accepted) {
          working = std::move(candidate);
          solved = general_solved;
          report.model = general;
        }
      }
      report.tests.push_back(test);
    }
    if (report.model != JointModel::kSharedStations) {
      // Observations that the simple model could not explain may fit now.
      for (JointBody* body : {&working.object, &working.background}) {
        const JointBody& original = body == &working.object ? problem->object : problem->background;
        for (size_t k = 0; k < body->observations.size(); ++k) {
          body->observations[k].active = original.observations[k].active;
        }
      }
      report.removed_observations = 0;
      report.undetermined_points = 0;
      const FilterCounts counts = FilterObservations(options, options.max_reprojection_error_px, &working);
      report.removed_observations += counts.observations;
      report.undetermined_points += counts.points;
      solved = SolveInRounds(fit_loss, reporter, &options, &working, &report);
    }
  }

  report.converged = solved.converged;
  report.linear_solver = solved.linear_solver;
  const Residuals residuals = MeasureResiduals(working);
  report.object_observations = residuals.object;
  report.background_observations = residuals.background;
  report.object_rms_px = std::sqrt(residuals.object_squares / std::max(1, residuals.object));
  report.background_rms_px = std::sqrt(residuals.background_squares / std::max(1, residuals.background));
  report.sigma_px = RobustSigma(residuals.coordinates, solved.parameters);
  if (options.compute_covariance) {
    report.observability = AnalyzeObservability(working, options, true, report.sigma_px);
    FillSigmas(working, options, &report);
  }
  *problem = std::move(working);
  report.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  return report;
}

}  // namespace s2gs
