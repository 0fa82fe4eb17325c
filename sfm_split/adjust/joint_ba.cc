#include "sfm_split/adjust/joint_ba.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <optional>
#include <utility>
#include <vector>

#include "sfm_split/adjust/joint_model.h"
#include "sfm_split/adjust/joint_sigmas.h"
#include "sfm_split/adjust/principal_point.h"
#include "sfm_split/adjust/wrong_pull.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/infinity.h"
#include "sfm_split/base/number_text.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/base/stopwatch.h"
#include "sfm_split/joint_system/joint_residuals.h"
#include "sfm_split/joint_system/joint_solve.h"
#include "sfm_split/joint_system/joint_system.h"
#include "sfm_split/joint_system/smooth_wobble.h"
#include "sfm_split/joint_system/track_weights.h"
#include "sfm_split/joint_system/wobble_prior.h"

namespace s2gs {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

// A general model is taken where each of its parameters lowers the cost by the logarithm of the number of
// residuals (CompareModels), and its score says by how much they do to within a factor: in 73 fits they
// lowered it by 2.6 times the score at most, by 1.9 in those that were taken.
constexpr double kMostOverScore = 3;
constexpr double kCoarseTolerance = 1e-6;  // of rounds that are followed by another
constexpr int kWeightRounds = 6;           // at most
constexpr double kWeightSettled = 0.05;    // of a weight's logarithm
constexpr int kWobbleRounds = 8;           // at most: its deviations and the poses are found by turns
constexpr double kWobbleSettled = 0.05;    // relative change of its standard deviations

// The loss' scale that the residuals of a problem ask for.
double LossScaleOf(const JointProblem& problem) {
  std::ptrdiff_t num_points = 0;
  for (const JointBody* body : {&problem.object, &problem.background}) {
    std::vector<bool> is_seen(body->points.size(), false);
    for (const JointObservation& observation : body->observations) {
      if (observation.active) is_seen[static_cast<size_t>(observation.point)] = true;
    }
    num_points += std::count(is_seen.begin(), is_seen.end(), true);
  }
  return LossScalePx(
      RobustSigmaPx(MeasureJointResiduals(problem).coordinates, 3 * static_cast<int>(num_points)));
}

// Alternates adjusting and taking observations out until nothing more goes.
// \param options  its loss' scale follows the residuals where `fit_loss`.
JointSolved SolveInRounds(bool fit_loss, Reporter& reporter, JointOptions* fitted_options,
                          JointProblem* problem, JointReport* report) {
  JointOptions& options = *fitted_options;
  JointSolved solved;
  for (int round = 0; round < options.max_rounds; ++round) {
    if (fit_loss) options.loss_scale_px = LossScaleOf(*problem);
    const bool may_be_last = round + 1 == options.max_rounds;
    solved = SolveJointOnce(
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
      solved = SolveJointOnce(options, options.function_tolerance, reporter, problem);
      report->iterations += solved.iterations;
      break;
    }
  }
  return solved;
}

// Object poses that are free lie about the table's turn, or about what a wobbling table does, by as much as
// they themselves tell: with poses that few keypoints see, both follow from each other. Between two looks at
// how far they lie a rough adjustment does.
JointSolved SolveWithWobble(bool fit_loss, JointModel model, Reporter& reporter, JointOptions* options,
                            JointProblem* problem, JointReport* report) {
  for (int round = 0; round < kWobbleRounds; ++round) {
    if (fit_loss) options->loss_scale_px = LossScaleOf(*problem);
    const double sigma_px = SigmaOfLossPx(options->loss_scale_px);
    const std::optional<WobblePrior> before = problem->priors.wobble;
    std::optional<WobblePrior> now;
    if (before && !before->harmonics.empty()) {
      now = FitDeviations(*problem, *options);
    } else if (model == JointModel::kWobblingTable) {
      now = NoWobble(*problem);
    }
    // Few photos tell no function of the angle.
    if (!now) now = FitWobble(*problem, *options, sigma_px);
    problem->priors.wobble = now;
    const auto is_near = [](double a, double b) { return std::abs(a - b) <= kWobbleSettled * b; };
    if (!now || (before && is_near(now->sigma_tilt_rad, before->sigma_tilt_rad) &&
                 is_near(now->sigma_shift, before->sigma_shift) &&
                 is_near(now->sigma_harmonic_tilt_rad, before->sigma_harmonic_tilt_rad) &&
                 is_near(now->sigma_harmonic_shift, before->sigma_harmonic_shift)))
      break;
    report->iterations +=
        SolveJointOnce(*options, std::max(kCoarseTolerance, options->function_tolerance), reporter, problem)
            .iterations;
  }
  return SolveInRounds(fit_loss, reporter, options, problem, report);
}

// How far free object poses lie from the turn, an adjustment without any prior tells first, where none before
// did. Harmonics start from none.
JointSolved Solve(bool fit_loss, JointModel model, Reporter& reporter, JointOptions* options,
                  JointProblem* problem, JointReport* report) {
  JointSolved solved;
  const bool is_told =
      problem->free_object && (problem->priors.wobble || model == JointModel::kWobblingTable);
  if (!is_told) solved = SolveInRounds(fit_loss, reporter, options, problem, report);
  if (problem->free_object) solved = SolveWithWobble(fit_loss, model, reporter, options, problem, report);
  return solved;
}

// Points of few keypoints count by what they say against longer tracks.
JointSolved WeighTracks(bool fit_loss, const JointSolved& solved_before, Reporter& reporter,
                        JointOptions* options, JointProblem* problem, JointReport* report) {
  JointSolved solved = solved_before;
  TrackWeights weights;
  for (int round = 0; round < kWeightRounds; ++round) {
    const double sigma_px = SigmaOfLossPx(fit_loss ? LossScaleOf(*problem) : options->loss_scale_px);
    const TrackWeights before = weights;
    weights = FitTrackWeights(*problem, *options, sigma_px);
    bool has_settled = true;
    for (int c = 0; c < TrackWeights::kClasses; ++c)
      has_settled &= std::abs(std::log(weights.of_class[c] / before.of_class[c])) <= kWeightSettled;
    if (has_settled) break;
    ApplyTrackWeights(weights, problem);
    report->point_correlation = weights.correlation;
    solved = SolveInRounds(fit_loss, reporter, options, problem, report);
  }
  return solved;
}

// Whether a general model may be taken, by its score.
bool IsWorthFitting(const ModelTest& test, const JointSolved& simple) {
  return test.score > kScoreWorthFitting && kMostOverScore * test.score > std::log(simple.residuals);
}

struct ChosenModel {
  JointProblem problem;
  JointSolved solved;
  JointModel model = JointModel::kSharedStations;
  std::vector<ModelTest> tests;
};

// Frees what the data ask for beyond shared stations, in the order of JointModel.
ChosenModel ChooseModel(const JointOptions& options, JointProblem shared, const JointSolved& solved,
                        Reporter& reporter, int* iterations) {
  ChosenModel chosen{std::move(shared), solved, JointModel::kSharedStations, {}};
  for (const JointModel general : {JointModel::kFreeCameras, JointModel::kFreeObject}) {
    ModelTest test;
    test.simple = chosen.model;
    test.general = general;
    const bool of_object = general == JointModel::kFreeObject;
    FillScores(chosen.problem, options, of_object, &test);
    if (IsWorthFitting(test, chosen.solved)) {
      JointProblem candidate =
          of_object ? WithFreeObject(chosen.problem) : WithFreeCameras(chosen.problem, options);
      const JointSolved general_solved =
          SolveJointOnce(options, options.function_tolerance, reporter, &candidate);
      *iterations += general_solved.iterations;
      CompareModels(chosen.solved, general_solved, &test);
      if (test.accepted) {
        chosen.problem = std::move(candidate);
        chosen.solved = general_solved;
        chosen.model = general;
      }
    }
    chosen.tests.push_back(test);
  }
  return chosen;
}

// Whether one of two models that do not contain each other is to be preferred, by the criterion of
// CompareModels.
bool ExplainsMore(const JointSolved& one, const JointSolved& other) {
  const double n = other.residuals;
  return n * std::log(other.cost / one.cost) > (one.parameters - other.parameters) * std::log(n);
}

// What is free of lens and poses. What a wrong lens leaves over can pass for an object that moves, and the
// other way round: free principal points are for photos that they explain without such an object, and better
// than it does. Where both would be free neither is told from the other, and lenses are seldom what is wrong.
ChosenModel ChooseLensAndModel(const JointOptions& options, const JointProblem& shared,
                               const JointSolved& solved, Reporter& reporter, int* iterations,
                               PrincipalPointTest* principal_point) {
  ChosenModel held = ChooseModel(options, shared, solved, reporter, iterations);
  FreedPrincipalPoint freed = FitPrincipalPoint(options, shared, solved, reporter);
  *principal_point = freed.test;
  if (!freed.test.accepted) return held;
  ChosenModel cut = ChooseModel(options, std::move(freed.problem), freed.solved, reporter, iterations);
  principal_point->accepted = cut.model != JointModel::kFreeObject && ExplainsMore(cut.solved, held.solved);
  return principal_point->accepted ? cut : held;
}

}  // namespace

std::optional<double> AnglePriorShare(const JointReport& report) {
  std::vector<double> shares;
  for (size_t i = 0; i < report.angle_prior_share.size(); ++i) {
    if (report.angle_sigma_deg[i] > 0 && std::isfinite(report.angle_sigma_deg[i]))
      shares.push_back(report.angle_prior_share[i]);
  }
  if (shares.empty()) return std::nullopt;
  return UpperMedian(std::move(shares));
}

FilterCounts FilterObservations(const JointOptions& options, double max_error_px, JointProblem* problem) {
  FilterCounts counts;
  const double least_cosine = std::cos(options.min_triangulation_deg * kPi / 180);
  const std::vector<Rigid3> world_from_object = problem->WorldFromObjects();
  for (const bool of_object : {true, false}) {
    JointBody& body = of_object ? problem->object : problem->background;
    const std::vector<std::optional<Vector2d>> errors = ReprojectionErrors(*problem, of_object);
    std::vector<std::vector<size_t>> of_point(body.points.size());
    for (size_t k = 0; k < body.observations.size(); ++k) {
      JointObservation& observation = body.observations[k];
      if (!observation.active) continue;
      if (errors[k] && errors[k]->norm() <= max_error_px * observation.spread) {
        of_point[observation.point].push_back(k);
      } else {
        observation.active = false;
        ++counts.observations;
      }
    }
    std::vector<Vector3d> centres;  // of each image's camera, in the body
    for (size_t i = 0; i < problem->images.size(); ++i) {
      const Vector3d centre = CameraCentre(problem->cam_from_world[problem->images[i].pose]);
      centres.push_back(of_object ? world_from_object[i].Inverse() * centre : centre);
    }
    std::vector<Vector3d> rays;
    for (size_t p = 0; p < body.points.size(); ++p) {
      if (of_point[p].empty()) continue;
      rays.clear();
      for (const size_t k : of_point[p])
        rays.push_back((centres[body.observations[k].image] - body.points[p]).normalized());
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
  const double start = SteadySeconds();
  JointReport report;
  JointProblem working = *problem;
  for (JointObservation& o : working.object.observations) o.weight = 1;
  // Gross errors stay for the robust loss; points without depth would only slow it down.
  report.undetermined_points = FilterObservations(options, kInfinity, &working).points;
  report.initial_rms_px = MeasureJointResiduals(working).Rms();
  report.model = JointModel::kSharedStations;
  if (working.free_object) {
    report.model = options.model == JointModel::kWobblingTable ? options.model : JointModel::kFreeObject;
  } else if (options.model == JointModel::kFreeCameras) {
    working = WithFreeCameras(working, options);
    report.model = JointModel::kFreeCameras;
  } else if (options.model == JointModel::kFreeObject || options.model == JointModel::kWobblingTable) {
    working = WithFreeObject(working);
    report.model = options.model;
  }
  JointSolved solved = Solve(fit_loss, report.model, reporter, &options, &working, &report);

  if (options.model == JointModel::kAuto && !working.free_object) {
    ChosenModel chosen =
        ChooseLensAndModel(options, working, solved, reporter, &report.iterations, &report.principal_point);
    working = std::move(chosen.problem);
    solved = chosen.solved;
    report.model = chosen.model;
    report.tests = std::move(chosen.tests);
    if (report.model != JointModel::kSharedStations || report.principal_point.accepted) {
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
      solved = Solve(fit_loss, report.model, reporter, &options, &working, &report);
    }
  }

  if (options.compute_covariance)
    solved = WeighTracks(fit_loss, solved, reporter, &options, &working, &report);
  report.converged = solved.converged;
  report.linear_solver = solved.linear_solver;
  const JointResiduals residuals = MeasureJointResiduals(working);
  report.object_observations = residuals.object;
  report.background_observations = residuals.background;
  report.object_rms_px = std::sqrt(residuals.object_squares / std::max(1, residuals.object));
  report.background_rms_px = std::sqrt(residuals.background_squares / std::max(1, residuals.background));
  report.sigma_px = RobustSigmaPx(residuals.coordinates, solved.parameters);
  if (working.priors.wobble) report.harmonics = static_cast<int>(working.priors.wobble->harmonics.size());
  if (options.compute_covariance) {
    report.observability = AnalyzeObservability(working, options, true, report.sigma_px);
    FillPullOfWrongOnes(working, options, report.sigma_px, reporter, &report.observability);
    FillSigmas(working, options, &report);
  }
  *problem = std::move(working);
  report.seconds = SteadySeconds() - start;
  return report;
}

}  // namespace s2gs
