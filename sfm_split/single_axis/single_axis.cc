#include "sfm_split/single_axis/single_axis.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <map>
#include <optional>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/number_text.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/scene/axis_turn.h"
#include "sfm_split/single_axis/image_turns.h"
#include "sfm_split/single_axis/single_axis_adjust.h"
#include "sfm_split/single_axis/single_axis_rays.h"
#include "sfm_split/single_axis/single_axis_search.h"
#include "sfm_split/single_axis/turn_epipolar.h"
#include "sfm_split/single_axis/turn_vote.h"
#include "sfm_split/turntable/axis_sense.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;

constexpr double kInlierSigmas = 3;  // beyond lie three in a thousand of right ones

class Solver {
 public:
  Solver(const SingleAxisInput& input, const SingleAxisOptions& options, Reporter& reporter)
      : input_(input), options_(options), reporter_(reporter), rng_(options.random_seed) {}

  SingleAxisSolution Solve();

 private:
  void FindTurns(double bound_px, TurntableAxis* axis);
  AxisNormal Adjust(double scale_px, int iterations, TurntableAxis* axis);
  double MarkInliers(const TurntableAxis& axis, double bound_px);
  int Reference() const;
  void Orient();
  void MeasureSteps();

  const SingleAxisInput& input_;
  const SingleAxisOptions& options_;
  Reporter& reporter_;
  std::mt19937 rng_;
  AxisRays rays_;
  ImageTurns turns_;
  SingleAxisSolution solution_;
};

// The first connected image by name; -1 without any.
int Solver::Reference() const {
  int reference = -1;
  for (size_t i = 0; i < rays_.cameras.size(); ++i) {
    if (turns_.connected[i] == 0) continue;
    if (reference < 0 || input_.images[i].name < input_.images[reference].name)
      reference = static_cast<int>(i);
  }
  return reference;
}

AxisNormal Solver::Adjust(double scale_px, int iterations, TurntableAxis* axis) {
  return AdjustAxisAndTurns(rays_, Reference(), scale_px, iterations, reporter_, axis, &turns_);
}

// Which matches agree with the axis and the images' angles; the robust standard deviation of their errors.
double Solver::MarkInliers(const TurntableAxis& axis, double bound_px) {
  solution_.inliers.assign(input_.pairs.size(), {});
  for (size_t p = 0; p < input_.pairs.size(); ++p)
    solution_.inliers[p].assign(input_.pairs[p].matches.size(), 0);
  for (SingleAxisImageFit& fit : solution_.images) fit.inliers = 0;
  std::vector<double> errors;
  size_t all = 0;
  for (const RayPair& pair : rays_.pairs) {
    if (turns_.connected[pair.image1] == 0 || turns_.connected[pair.image2] == 0) continue;
    const double angle = turns_.angles[pair.image2] - turns_.angles[pair.image1];
    const RayCamera& first = rays_.cameras[pair.image1];
    const RayCamera& second = rays_.cameras[pair.image2];
    const Matrix3d e = EssentialOfTurn<double>(first, second, axis.direction, axis.point, angle);
    const Matrix3d turn = RotationAbout<double>(axis.direction, angle);
    all += pair.matches.size();
    for (const RayMatch& match : pair.matches) {
      const double error = std::abs(pair.focal * SampsonError<double>(e, match));
      if (!(error <= bound_px) || !MeetInFront(first, second, axis, turn, match)) continue;
      errors.push_back(error);
      solution_.inliers[pair.index][match.index] = 1;
      ++solution_.images[pair.image1].inliers;
      ++solution_.images[pair.image2].inliers;
    }
  }
  solution_.inlier_ratio = all > 0 ? static_cast<double>(errors.size()) / static_cast<double>(all) : 0;
  return kSigmaOfMad * UpperMedian(errors);
}

// The axis' sign: cameras look down, or image tops are up where they look level.
void Solver::Orient() {
  std::vector<Matrix3d> cam_from_world;
  for (size_t i = 0; i < rays_.cameras.size(); ++i) {
    if (turns_.connected[i] != 0) cam_from_world.push_back(rays_.cameras[i].from_world);
  }
  if (cam_from_world.empty() || AxisUpSign(solution_.axis.direction, cam_from_world) > 0) return;
  solution_.axis.direction = -solution_.axis.direction;
  for (double& angle : turns_.angles) angle = -angle;
}

void Solver::MeasureSteps() {
  std::map<int, std::vector<std::pair<std::string, size_t>>> stations;
  for (size_t i = 0; i < rays_.cameras.size(); ++i) {
    if (solution_.images[i].found) stations[input_.images[i].station].emplace_back(input_.images[i].name, i);
  }
  for (auto& [station, images] : stations) {
    if (images.size() < 4) continue;
    std::sort(images.begin(), images.end());
    std::vector<double> steps;
    for (size_t k = 1; k < images.size(); ++k) {
      steps.push_back(WrapAngle(solution_.images[images[k].second].angle_rad -
                                solution_.images[images[k - 1].second].angle_rad));
    }
    // Unwrapped along the median step, then a line.
    const double median = UpperMedian(steps);
    const double first = solution_.images[images[0].second].angle_rad;
    const auto n = static_cast<double>(images.size());
    double variance = 0;
    std::vector<Eigen::Vector2d> rest;
    for (size_t k = 0; k < images.size(); ++k) {
      const SingleAxisImageFit& fit = solution_.images[images[k].second];
      const auto x = static_cast<double>(k);
      rest.emplace_back(x, WrapAngle(fit.angle_rad - first - median * x));
      variance += fit.sigma_deg * fit.sigma_deg / n;
    }
    const Line line = FitLine(rest).value();  // of four places or more
    double squares = 0;
    for (const Eigen::Vector2d& at : rest) {
      const double r = at.y() - line.start - line.slope * at.x();
      squares += r * r / n;
    }
    EqualSteps steps_of_station;
    steps_of_station.station = station;
    steps_of_station.step_deg = (median + line.slope) / kDegree;
    steps_of_station.rms_deg = std::sqrt(squares) / kDegree;
    steps_of_station.consistent = steps_of_station.rms_deg <= 3 * std::sqrt(variance) + 1e-9;
    solution_.steps.push_back(steps_of_station);
  }
}

// Angles of all images, axis and angles adjusted together, which matches agree, and standard deviations.
void Solver::FindTurns(double bound_px, TurntableAxis* axis) {
  // Twice: the axis adjusted to all pairs tells the pairs' angles better than the one of the search.
  for (int pass = 0; pass < 2; ++pass) {
    std::vector<TurnVote> votes;
    votes.reserve(rays_.pairs.size());
    for (const RayPair& pair : rays_.pairs) votes.push_back(BestTurn(rays_, pair, *axis, bound_px, 120));
    turns_ = SynchronizeTurns(rays_, votes);
    for (const double scale : {8.0, 4.0, 2.0, 1.0}) Adjust(scale * bound_px, 5, axis);
  }
  const auto keep_connected = [&] {
    turns_.connected = LargestConnected(rays_, solution_.inliers, turns_.connected);
  };
  double sigma = MarkInliers(*axis, bound_px);
  keep_connected();
  for (int round = 0; round < 2; ++round) {
    // Drawn in to what the noise turns out to be, but not to nothing: rounding is no noise.
    const double least = std::max(sigma, 1e-9);
    Adjust(2.5 * least, 15, axis);
    sigma = MarkInliers(*axis, std::max(std::min(bound_px, 4 * least), 1e-6));
    keep_connected();
  }
  solution_.sigma_px = sigma;
  const AxisNormal normal = Adjust(2.5 * std::max(sigma, 1e-9), 20, axis);
  const AxisSigmas sigmas = SigmasOf(rays_, normal, sigma);
  solution_.axis_direction_sigma_deg = sigmas.direction_deg;
  solution_.axis_point_sigma = sigmas.point;
  for (size_t i = 0; i < solution_.images.size(); ++i) solution_.images[i].sigma_deg = sigmas.of_turn_deg[i];
  MarkInliers(*axis, bound_px);
}

SingleAxisSolution Solver::Solve() {
  solution_.images.resize(input_.images.size());
  solution_.inliers.resize(input_.pairs.size());
  for (size_t p = 0; p < input_.pairs.size(); ++p)
    solution_.inliers[p].assign(input_.pairs[p].matches.size(), 0);
  std::optional<AxisRays> rays = CollectRays(input_, options_, &rng_, &solution_.reason);
  if (!rays) return solution_;
  rays_ = std::move(*rays);
  solution_.scale_observable = rays_.scale_observable;

  const double bound = kInlierSigmas * options_.noise_px;
  const AxisSearch search = SearchAxis(rays_, options_, bound, &rng_, reporter_);
  solution_.margin = search.margin;
  solution_.axis = search.axis;
  FindTurns(bound, &solution_.axis);
  solution_.reference = Reference();
  Orient();
  const auto found = std::count(turns_.connected.begin(), turns_.connected.end(), 1);
  if (found < 2) {
    solution_.reason = "no two images agree on a turn";
    return solution_;
  }
  if (solution_.inlier_ratio < options_.min_inlier_ratio) {
    solution_.reason = "too few matches agree with any one axis";
    return solution_;
  }
  const double zero = turns_.angles[solution_.reference];
  for (size_t i = 0; i < solution_.images.size(); ++i) {
    SingleAxisImageFit& fit = solution_.images[i];
    fit.found = turns_.connected[i] != 0;
    fit.angle_rad = fit.found ? WrapAngle(turns_.angles[i] - zero) : 0;
  }
  solution_.found = true;
  MeasureSteps();
  return solution_;
}

}  // namespace

OptionCheck SingleAxisOptions::Check() const {
  const auto fault = [](const char* field, double value, const char* bound) {
    return OptionFault{field, NumberText(value), bound};
  };
  if (!(noise_px > 0)) return fault("noise_px", noise_px, "noise_px > 0");
  if (min_matches < 3) return fault("min_matches", min_matches, "min_matches >= 3");
  if (max_search_pairs < 1) return fault("max_search_pairs", max_search_pairs, "max_search_pairs >= 1");
  if (max_search_matches < 3)
    return fault("max_search_matches", max_search_matches, "max_search_matches >= 3");
  if (num_directions < 1) return fault("num_directions", num_directions, "num_directions >= 1");
  if (offsets_per_side < 1) return fault("offsets_per_side", offsets_per_side, "offsets_per_side >= 1");
  if (num_refined < 1) return fault("num_refined", num_refined, "num_refined >= 1");
  if (max_matches < 3) return fault("max_matches", max_matches, "max_matches >= 3");
  return std::nullopt;
}

Rigid3 SingleAxisSolution::WorldFromObject(int image) const {
  return TurnAbout(axis, images[image].angle_rad);
}

SingleAxisSolution SolveSingleAxis(const SingleAxisInput& input, const SingleAxisOptions& options,
                                   Reporter& reporter) {
  S2GS_INVARIANT(!options.Check());
  return Solver(input, options, reporter).Solve();
}

}  // namespace s2gs
