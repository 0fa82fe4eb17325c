#include "sfm_split/single_axis/single_axis_search.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <vector>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/single_axis/turn_epipolar.h"
#include "sfm_split/single_axis/turn_vote.h"
#include "sfm_split/solvers/eigen_solvers.h"

namespace s2gs {
namespace {

using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;

constexpr double kMaxBound =
    40;  // error bound while the axis is far off, in standard deviations of a keypoint
constexpr double kDistinctAxes = 15 * kPi / 180;  // farther apart are two answers

struct Candidate {
  TurntableAxis axis;
  double score = 0;
};

// The pairs that judge axes: those with most matches, no image too often.
std::vector<RayPair> SearchPairs(const AxisRays& rays, const SingleAxisOptions& options, std::mt19937* rng) {
  std::vector<int> order(rays.pairs.size());
  std::iota(order.begin(), order.end(), 0);
  std::shuffle(order.begin(), order.end(), *rng);
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) {
    const size_t most = static_cast<size_t>(options.max_search_matches);
    return std::min(rays.pairs[a].matches.size(), most) > std::min(rays.pairs[b].matches.size(), most);
  });
  std::vector<RayPair> chosen;
  std::vector<char> taken(rays.pairs.size(), 0);
  std::vector<int> uses(rays.cameras.size(), 0);
  for (int limit = 1; limit <= 64 && static_cast<int>(chosen.size()) < options.max_search_pairs; limit *= 2) {
    for (const int p : order) {
      if (static_cast<int>(chosen.size()) == options.max_search_pairs) break;
      if (taken[p] != 0 || uses[rays.pairs[p].image1] >= limit || uses[rays.pairs[p].image2] >= limit)
        continue;
      taken[p] = 1;
      ++uses[rays.pairs[p].image1];
      ++uses[rays.pairs[p].image2];
      chosen.push_back(rays.pairs[p]);
      if (static_cast<int>(chosen.back().matches.size()) > options.max_search_matches) {
        chosen.back().matches.resize(options.max_search_matches);
      }
    }
  }
  return chosen;
}

// While the axis is far off, errors are a share of how far the matches moved.
double SearchBound(const RayPair& pair, double factor, double least_px, double most_px) {
  std::vector<double> moved;
  for (const RayMatch& match : pair.matches) {
    moved.push_back((match.first.in_cam - match.second.in_cam).head<2>().norm() * pair.focal);
  }
  return std::clamp(factor * UpperMedian(moved), least_px, most_px);
}

std::vector<Candidate> CoarseSearch(const AxisRays& rays, const std::vector<RayPair>& pairs,
                                    const SingleAxisOptions& options, double least_bound,
                                    Reporter& reporter) {
  std::vector<double> bounds;
  bounds.reserve(pairs.size());
  for (const RayPair& pair : pairs)
    bounds.push_back(SearchBound(pair, 0.1, least_bound, kMaxBound * options.noise_px));
  const double golden = kPi * (3 - std::sqrt(5.0));
  std::vector<Candidate> candidates;
  for (int k = 0; k < options.num_directions; ++k) {
    reporter.Progress("search for the axis", k, options.num_directions);
    if (reporter.StopRequested()) throw Interrupted();
    const double z = (k + 0.5) / options.num_directions;
    const double r = std::sqrt(1 - z * z);
    const Vector3d direction(r * std::cos(golden * k), r * std::sin(golden * k), z);
    const AxisFrame frame = FrameAcross(direction, rays.sight);
    Candidate best_here;
    const int side = options.offsets_per_side;
    const auto offset = [&](int i) { return side > 1 ? rays.radius * (2.0 * i / (side - 1) - 1) : 0.0; };
    for (int i = 0; i < side; ++i) {
      for (int j = 0; j < (rays.scale_observable ? side : 1); ++j) {
        Candidate candidate;
        candidate.axis.direction = direction;
        candidate.axis.point = rays.target + offset(i) * frame.b1;
        if (rays.scale_observable) candidate.axis.point += offset(j) * frame.b2;
        for (size_t p = 0; p < pairs.size(); ++p) {
          candidate.score += BestTurn(rays, pairs[p], candidate.axis, bounds[p], 8).score;
        }
        if (candidate.score > best_here.score) best_here = candidate;
      }
    }
    candidates.push_back(best_here);
  }
  std::sort(candidates.begin(), candidates.end(),
            [](const Candidate& a, const Candidate& b) { return a.score > b.score; });
  return candidates;
}

// Votes and Gauss-Newton steps in turn, with the bound drawn in to `last_bound`; each pair's angle is
// eliminated from the normal equations.
Candidate Refine(const AxisRays& rays, const std::vector<RayPair>& pairs, const SingleAxisOptions& options,
                 double last_bound, Candidate candidate) {
  const int num = rays.AxisParameters();
  for (double factor = 0.1; factor > 0.003; factor *= 0.6) {
    const AxisFrame frame = FrameAcross(candidate.axis.direction, rays.sight);
    MatrixXd normal = 1e-9 * MatrixXd::Identity(num, num);
    VectorXd right = VectorXd::Zero(num);
    for (const RayPair& pair : pairs) {
      const double bound =
          std::max(last_bound, SearchBound(pair, factor, last_bound, kMaxBound * options.noise_px));
      const TurnVote vote = BestTurn(rays, pair, candidate.axis, bound, 24);
      if (vote.score < 3) continue;
      MatrixXd of_pair = MatrixXd::Zero(num, num);
      VectorXd gradient = VectorXd::Zero(num);
      VectorXd mixed = VectorXd::Zero(num);
      double of_angle = 1e-12;
      double gradient_angle = 0;
      LinearizePair(rays, pair, candidate.axis, frame, vote.angle, 0.5 * bound,
                    [&](double error, const Eigen::Matrix<double, 5, 1>& derivative, double weight) {
                      if (std::abs(error) > bound) return;
                      const VectorXd j = derivative.head(num);
                      of_pair += weight * j * j.transpose();
                      gradient += weight * j * error;
                      mixed += weight * j * derivative(4);
                      of_angle += weight * derivative(4) * derivative(4);
                      gradient_angle += weight * derivative(4) * error;
                    });
      // In units of the pair's bound, so that pairs of long and of short moves count alike.
      normal += (of_pair - mixed * mixed.transpose() / of_angle) / (bound * bound);
      right -= (gradient - mixed * gradient_angle / of_angle) / (bound * bound);
    }
    VectorXd step = normal.ldlt().solve(right);
    if (!step.allFinite()) break;
    const double longest = step.cwiseAbs().maxCoeff();
    if (longest > 0.3) step *= 0.3 / longest;
    candidate.axis = MovedAxis(rays, candidate.axis, frame, step);
  }
  candidate.score = 0;
  for (const RayPair& pair : pairs) {
    candidate.score += std::max(0.0, BestTurn(rays, pair, candidate.axis, last_bound, 48).score - 2);
  }
  return candidate;
}

}  // namespace

AxisSearch SearchAxis(const AxisRays& rays, const SingleAxisOptions& options, double bound_px,
                      std::mt19937* rng, Reporter& reporter) {
  const std::vector<RayPair> pairs = SearchPairs(rays, options, rng);
  std::vector<Candidate> candidates = CoarseSearch(rays, pairs, options, bound_px, reporter);
  if (static_cast<int>(candidates.size()) > options.num_refined) candidates.resize(options.num_refined);
  for (Candidate& candidate : candidates) {
    if (reporter.StopRequested()) throw Interrupted();
    candidate = Refine(rays, pairs, options, bound_px, candidate);
  }
  std::sort(candidates.begin(), candidates.end(),
            [](const Candidate& a, const Candidate& b) { return a.score > b.score; });
  AxisSearch search;
  search.axis = candidates[0].axis;
  search.margin = std::numeric_limits<double>::infinity();
  for (const Candidate& other : candidates) {
    if (std::abs(other.axis.direction.dot(search.axis.direction)) > std::cos(kDistinctAxes)) continue;
    search.margin = candidates[0].score / std::max(other.score, 1e-9);
    break;
  }
  return search;
}

}  // namespace s2gs
