#include "sfm_split/adjust/principal_point.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>
#include <vector>

#include "sfm_split/adjust/joint_model.h"
#include "sfm_split/base/infinity.h"
#include "sfm_split/joint_system/joint_residuals.h"
#include "sfm_split/joint_system/joint_system.h"

namespace s2gs {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

// In longer sides: cutting a quarter off one side moves the middle of what is left by a sixth of it.
constexpr double kCutSigma = 0.1;
// Photos that were cut beside their middle: one set in twenty.
constexpr double kOddsAgainst = 20;

constexpr int kLookIterations = 6;  // of looking whether anything is to be gained
// Longer sides: about kCutSigma, so that a quarter cut off lies by one of nine starts.
constexpr double kStartStep = 0.12;
constexpr int kStartObservations = 6000;  // a choice of seconds: all cost minutes; starts are only told apart
constexpr int kStartIterations = 15;      // of each loss; likewise
constexpr double kStartLossPx = 4;        // poses are turned to each start by their pinholes alone
// Of the cost, relative: rough, as only costs that differ by much decide.
constexpr double kStartTolerance = 1e-5;

double LongerSide(const Camera& camera) { return static_cast<double>(std::max(camera.width, camera.height)); }

// Points that most photos see, of each body, until enough observations are left.
JointProblem Thinned(const JointProblem& problem) {
  JointProblem thin = problem;
  for (JointBody* body : {&thin.object, &thin.background}) {
    std::vector<int> seen(body->points.size(), 0);
    for (const JointObservation& observation : body->observations)
      seen[static_cast<size_t>(observation.point)] += observation.active ? 1 : 0;
    std::vector<size_t> order(seen.size());
    std::iota(order.begin(), order.end(), size_t{0});
    std::stable_sort(order.begin(), order.end(), [&](size_t a, size_t b) { return seen[a] > seen[b]; });
    std::vector<bool> stays(seen.size(), false);
    int left = kStartObservations;
    for (const size_t p : order) {
      if (left <= 0) break;
      left -= seen[p];
      stays[p] = true;
    }
    for (JointObservation& observation : body->observations)
      observation.active &= stays[static_cast<size_t>(observation.point)];
  }
  return thin;
}

// Principal points moved by a share of the longer sides; cameras turn so that a pinhole's picture stays, and
// distortion, which stood for it, is as expected again.
JointProblem StartedAt(const Vector2d& shift, const JointProblem& problem) {
  JointProblem started = problem;
  std::vector<Eigen::Quaterniond> turns;
  for (size_t c = 0; c < started.cameras.size(); ++c) {
    Camera& camera = started.cameras[c];
    const CameraModelInfo& info = InfoOf(camera.model);
    const Vector2d moved = shift * LongerSide(camera);
    const Vector2d focal = FocalLengths(camera);
    camera.params[info.num_focal_params] += moved.x();
    camera.params[info.num_focal_params + 1] += moved.y();
    const std::optional<size_t> k = DistortionPlace(camera);
    const LensPrior& lens = started.priors.lenses[c];
    if (k && lens.distortion) camera.params[*k] = *lens.distortion;
    turns.push_back(Eigen::Quaterniond::FromTwoVectors(
        Vector3d::UnitZ(), Vector3d(-moved.x() / focal.x(), -moved.y() / focal.y(), 1)));
  }
  std::vector<bool> is_turned(started.cam_from_world.size(), false);
  for (const JointImage& image : started.images) {
    const auto pose = static_cast<size_t>(image.pose);
    if (is_turned[pose]) continue;
    is_turned[pose] = true;
    const Eigen::Quaterniond& turn = turns[static_cast<size_t>(image.camera)];
    Rigid3& cam_from_world = started.cam_from_world[pose];
    cam_from_world.rotation = (turn * cam_from_world.rotation).normalized();
    cam_from_world.translation = turn * cam_from_world.translation;
  }
  return started;
}

// The farthest of all cameras', in longer sides, from the mean of its prior.
Vector2d FarthestShift(const JointProblem& problem) {
  Vector2d farthest = Vector2d::Zero();
  for (size_t c = 0; c < problem.cameras.size(); ++c) {
    const Vector2d shift =
        PrincipalPointShift(problem.cameras[c], problem.priors.lenses[c].principal->mean_px);
    if (shift.norm() > farthest.norm()) farthest = shift;
  }
  return farthest;
}

JointSolved SolveStart(const JointOptions& options, Reporter& reporter, JointProblem* problem) {
  JointOptions rough = options;
  rough.max_iterations = kStartIterations;
  rough.loss = JointLoss::kHuber;
  rough.loss_scale_px = std::max(options.loss_scale_px, kStartLossPx);
  SolveJointOnce(rough, kStartTolerance, reporter, problem);
  rough.loss = options.loss;
  rough.loss_scale_px = options.loss_scale_px;
  return SolveJointOnce(rough, kStartTolerance, reporter, problem);
}

Vector2d BestStart(const JointOptions& options, const JointProblem& problem, Reporter& reporter) {
  const JointProblem thin = Thinned(problem);
  Vector2d best = Vector2d::Zero();
  double least = kInfinity;
  for (const double x : {0.0, -kStartStep, kStartStep}) {
    for (const double y : {0.0, -kStartStep, kStartStep}) {
      JointProblem start = StartedAt({x, y}, thin);
      const double cost = SolveStart(options, reporter, &start).cost;
      if (!(cost < least)) continue;
      least = cost;
      best = {x, y};
    }
  }
  return best;
}

// Twice the logarithm of the odds for free principal points: the Bayesian information criterion of residuals
// whose variance is theirs times what their photos have in common.
double TwiceLogOdds(const JointSolved& held, const JointSolved& freed, double overdispersion) {
  const int extra = freed.parameters - held.parameters;
  if (extra <= 0 || !(held.cost > 0 && freed.cost > 0)) return -kInfinity;
  const double n = std::max(1.0, freed.residuals / overdispersion);
  return n * std::log(held.cost / freed.cost) - extra * std::log(n) - 2 * std::log(kOddsAgainst);
}

// What principal points gain and where they come to where distortion is held as it is expected. Before one
// camera place a pinhole's pictures are the same for principal points all along the axis, f^2 + (h - c)^2
// being constant with the horizon's height h: what is gained along it, is gained by a distortion about
// another centre alone. That bends the photos by a fraction of a pixel, as keypoints do that slide with the
// light, alike in all photos.
PrincipalPointTest TestPinholes(const JointOptions& options, const JointProblem& held_problem,
                                const JointProblem& freed_problem, double overdispersion,
                                Reporter& reporter) {
  JointOptions straight = options;
  straight.refine_extra_params = false;
  JointProblem held = held_problem;
  for (size_t c = 0; c < held.cameras.size(); ++c) {
    const std::optional<size_t> k = DistortionPlace(held.cameras[c]);
    const LensPrior& lens = held.priors.lenses[c];
    if (k && lens.distortion) held.cameras[c].params[*k] = *lens.distortion;
  }
  const JointSolved by_held = SolveJointOnce(straight, options.function_tolerance, reporter, &held);
  JointProblem freed = held;
  freed.priors.lenses = freed_problem.priors.lenses;
  const JointSolved by_freed = SolveJointOnce(straight, options.function_tolerance, reporter, &freed);
  PrincipalPointTest test;
  test.gain = TwiceLogOdds(by_held, by_freed, overdispersion);
  test.shift = FarthestShift(freed);
  return test;
}

// Whether pinholes' principal points bear out what was found with distortion: they leave the lens' own
// tolerance, and lie nearer to what was found than to the middle. A lens that is a little beside it across
// the axis is no ground for a shift along it.
bool BearsOut(const Vector2d& pinholes_shift, const Vector2d& found_shift) {
  const double from_middle = pinholes_shift.norm();
  return from_middle > kMostLensShift && (pinholes_shift - found_shift).norm() < from_middle;
}

}  // namespace

PrincipalPointPrior CutPhotoPrior(const Camera& camera, const Vector2d& expected_px) {
  return {expected_px, kCutSigma * LongerSide(camera)};
}

std::optional<double> TwiceLogOddsByShift(const JointOptions& options, const JointProblem& freed,
                                          const JointSolved& solved) {
  const JointResiduals residuals = MeasureJointResiduals(freed);
  const double sigma_px = RobustSigmaPx(residuals.coordinates, solved.parameters);
  const Observability observability = AnalyzeObservability(freed, options, true, sigma_px);
  if (!observability.computed) return std::nullopt;
  const JointSystem system(freed, options, true);
  std::vector<int> places;
  std::vector<double> shifts;
  for (size_t c = 0; c < freed.cameras.size(); ++c) {
    const Camera& camera = freed.cameras[c];
    const Vector2d shift = PrincipalPoint(camera) - freed.priors.lenses[c].principal->mean_px;
    for (int xy = 0; xy < 2; ++xy) {
      const std::pair<int, int> parameter(system.IntrinsicsBlock(static_cast<int>(c)),
                                          static_cast<int>(InfoOf(camera.model).num_focal_params) + xy);
      const auto found =
          std::find(observability.parameters.begin(), observability.parameters.end(), parameter);
      if (found == observability.parameters.end()) continue;
      places.push_back(static_cast<int>(found - observability.parameters.begin()));
      shifts.push_back(shift(xy));
    }
  }
  const auto extra = static_cast<double>(places.size());
  const Eigen::VectorXd shift = Eigen::VectorXd::Map(shifts.data(), places.size());
  double squares = kInfinity;
  for (const Eigen::MatrixXd* covariance :
       {&observability.covariance, &observability.robust_covariance, &observability.regional_covariance,
        &observability.ring_covariance}) {
    const Eigen::MatrixXd of_shift = (*covariance)(places, places);
    squares = std::min(squares, shift.dot(of_shift.ldlt().solve(shift)));
  }
  return squares - extra * std::log(std::max(1, solved.residuals)) - 2 * std::log(kOddsAgainst);
}

FreedPrincipalPoint FitPrincipalPoint(const JointOptions& options, const JointProblem& held_problem,
                                      const JointSolved& held, Reporter& reporter) {
  FreedPrincipalPoint freed;
  freed.problem = held_problem;
  JointProblem& problem = freed.problem;
  if (!options.refine_focal_length || options.refine_principal_point) return freed;
  if (problem.cameras.empty() || problem.priors.lenses.size() != problem.cameras.size()) return freed;
  for (size_t c = 0; c < problem.cameras.size(); ++c) {
    if (problem.priors.lenses[c].principal) return freed;
    problem.priors.lenses[c].principal =
        CutPhotoPrior(problem.cameras[c], PrincipalPoint(problem.cameras[c]));
  }
  JointOptions look = options;
  look.max_iterations = kLookIterations;
  JointProblem from_held = problem;
  freed.test.gain =
      TwiceLogOdds(held, SolveJointOnce(look, options.function_tolerance, reporter, &from_held), 1);
  if (freed.test.gain <= 0) return freed;

  freed.test.fitted = true;
  JointProblem from_start = StartedAt(BestStart(options, problem, reporter), problem);
  SolveStart(options, reporter, &from_start);
  freed.solved = SolveJointOnce(options, options.function_tolerance, reporter, &from_start);
  const JointSolved near = SolveJointOnce(options, options.function_tolerance, reporter, &from_held);
  const bool is_near = near.cost <= freed.solved.cost;
  if (is_near) freed.solved = near;
  problem = std::move(is_near ? from_held : from_start);

  freed.test.shift = FarthestShift(problem);
  for (const bool of_object : {true, false}) {
    ModelTest photos;
    FillScores(problem, options, of_object, &photos);
    freed.test.overdispersion = std::max(freed.test.overdispersion, photos.score);
  }
  freed.test.gain = TwiceLogOdds(held, freed.solved, freed.test.overdispersion);
  if (freed.test.gain > 0 && freed.test.shift.norm() > kMostLensShift) {
    const PrincipalPointTest pinholes =
        TestPinholes(options, held_problem, problem, freed.test.overdispersion, reporter);
    freed.test.gain = std::min(freed.test.gain, pinholes.gain);
    freed.test.accepted = freed.test.gain > 0 && BearsOut(pinholes.shift, freed.test.shift);
    if (!freed.test.accepted) return freed;
    const std::optional<double> of_shift = TwiceLogOddsByShift(options, problem, freed.solved);
    if (of_shift) freed.test.gain = std::min(freed.test.gain, *of_shift);
    freed.test.accepted = freed.test.gain > 0;
  }
  return freed;
}

}  // namespace s2gs
