#include "sfm_split/circular_motion/circular_likelihood.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/circular_motion/match_mixture.h"
#include "sfm_split/solvers/eigen_solvers.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::VectorXd;
using Vector6d = Eigen::Matrix<double, 6, 1>;
using Matrix6d = Eigen::Matrix<double, 6, 6>;

constexpr size_t kWorthThreads = 5000;  // matches: some .5 ms
constexpr int kMaxAttempts = 8;         // of one step, with ever more damping

// A keypoint as a ray with z = 1, and how that moves with the lens.
struct LensPoint {
  bool is_valid = false;
  Vector3d ray = Vector3d::UnitZ();
  Vector3d by_log_focal = Vector3d::Zero();
  Vector3d by_distortion = Vector3d::Zero();
  double px = 1;  // pixels per unit in the plane z = 1, here
};

// \param focal  of the lens [px].
LensPoint ThroughLens(const CircularLens& lens, double focal, const Vector2d& xy) {
  const Vector2d distorted = xy / focal;
  const double rd = distorted.norm();
  const double k = lens.distortion;
  double r = rd;
  if (k != 0) {
    // The lens turns back where 1 + 3 k r^2 = 0.
    if (k < 0 && rd >= 2 / std::sqrt(-27 * k)) return {};
    for (int iteration = 0; iteration < 8; ++iteration) {
      r -= (r * (1 + k * r * r) - rd) / std::max(1 + 3 * k * r * r, 0.05);
    }
  }
  LensPoint point;
  const double slope = 1 + 3 * k * r * r;
  if (!(slope > 0.05) || !std::isfinite(r)) return {};
  const double ratio = 1 / (1 + k * r * r);
  point.is_valid = true;
  const Vector2d u = ratio * distorted;
  point.ray << u, 1;
  point.by_log_focal << -u * (1 / (ratio * slope)), 0;
  point.by_distortion << -u * (r * r / slope), 0;
  point.px = focal * (1 + 2 * k * r * r);
  return point;
}

Matrix3d EssentialInFrame(double angle) {
  const double c = std::cos(angle);
  const double s = std::sin(angle);
  Matrix3d r;
  r << c, -s, 0, s, c, 0, 0, 0, 1;
  return CrossMatrix<double>(Vector3d(1 - c, -s, 0)) * r;
}

Matrix3d EssentialByAngle(double angle) {
  const double c = std::cos(angle);
  const double s = std::sin(angle);
  Matrix3d r;
  Matrix3d dr;
  r << c, -s, 0, s, c, 0, 0, 0, 1;
  dr << -s, -c, 0, c, -s, 0, 0, 0, 0;
  return CrossMatrix<double>(Vector3d(s, -c, 0)) * r + CrossMatrix<double>(Vector3d(1 - c, -s, 0)) * dr;
}

// Errors of a pair's matches [px]; infinite where there is none.
struct PairErrors {
  std::vector<double> errors;
  std::vector<Vector6d> derivatives;  // by log focal length, distortion, turn of the frame, angle
};

// Matches that move farther than the turn can move them have none: an axis beside the camera and a turn of
// next to nothing explain any displacements.
void ErrorsOf(const CircularMatches::Pair& pair, double reach_px, const CircularLens& lens,
              const CircularTurn& turn, bool with_derivatives, PairErrors* result) {
  const double angle =
      turn.angles[static_cast<size_t>(pair.photo2)] - turn.angles[static_cast<size_t>(pair.photo1)];
  const Matrix3d e = turn.frame * EssentialInFrame(angle) * turn.frame.transpose();
  Matrix3d by_angle;
  std::array<Matrix3d, 3> by_turn;
  if (with_derivatives) {
    by_angle = turn.frame * EssentialByAngle(angle) * turn.frame.transpose();
    for (int k = 0; k < 3; ++k) {
      const Matrix3d cross = CrossMatrix<double>(Vector3d(Vector3d::Unit(k)));
      by_turn[static_cast<size_t>(k)] = cross * e - e * cross;
    }
  }
  const size_t num = pair.matches.size();
  result->errors.assign(num, std::numeric_limits<double>::infinity());
  if (with_derivatives) result->derivatives.assign(num, Vector6d::Zero());
  const double farthest_px =
      reach_px > 0 ? reach_px * 2 * std::abs(std::sin(angle / 2)) : std::numeric_limits<double>::infinity();
  const double focal = std::exp(lens.log_focal);
  for (size_t m = 0; m < num; ++m) {
    if ((pair.matches[m].second - pair.matches[m].first).norm() > farthest_px) continue;
    const LensPoint first = ThroughLens(lens, focal, pair.matches[m].first);
    const LensPoint second = ThroughLens(lens, focal, pair.matches[m].second);
    if (!first.is_valid || !second.is_valid) continue;
    const Vector3d line2 = e * first.ray;
    const Vector3d line1 = e.transpose() * second.ray;
    const double squared = line2.head<2>().squaredNorm() / (second.px * second.px) +
                           line1.head<2>().squaredNorm() / (first.px * first.px);
    if (!(squared > 1e-30)) continue;
    const double scale = 1 / std::sqrt(squared);
    result->errors[m] = scale * second.ray.dot(line2);
    if (!with_derivatives) continue;
    // Of the numerator, and of half the denominator's square: both grow with the angle alike.
    Vector6d& d = result->derivatives[m];
    Vector6d half = Vector6d::Zero();
    const double of1 = 1 / (first.px * first.px);
    const double of2 = 1 / (second.px * second.px);
    const auto along = [&](int k, const Vector3d& d_line2, const Vector3d& d_line1) {
      half(k) = of2 * line2.head<2>().dot(d_line2.head<2>()) + of1 * line1.head<2>().dot(d_line1.head<2>());
    };
    d(0) = second.by_log_focal.dot(line2) + first.by_log_focal.dot(line1);
    along(0, e * first.by_log_focal, e.transpose() * second.by_log_focal);
    half(0) -= squared;  // pixels per unit grow with the focal length
    d(1) = second.by_distortion.dot(line2) + first.by_distortion.dot(line1);
    along(1, e * first.by_distortion, e.transpose() * second.by_distortion);
    for (int k = 0; k < 4; ++k) {
      const Matrix3d& change = k < 3 ? by_turn[static_cast<size_t>(k)] : by_angle;
      const Vector3d d_line2 = change * first.ray;
      d(2 + k) = second.ray.dot(d_line2);
      along(2 + k, d_line2, change.transpose() * second.ray);
    }
    d -= (result->errors[m] * scale) * half;
    d *= scale;
  }
}

// At the share of right matches of a pair that makes its likelihood greatest.
struct PairMixture {
  double gain = 0;
  std::vector<double> right;  // probability of each match
};

PairMixture MixtureOf(const CircularMatches::Pair& pair, const std::vector<double>& errors, double sigma_px) {
  std::vector<double> over;  // density of a right match's error over that of a wrong one's
  over.reserve(errors.size());
  const double peak = 1 / (sigma_px * kRootTwoPi);
  for (size_t m = 0; m < errors.size(); ++m) {
    const double ratio = errors[m] / sigma_px;
    over.push_back(std::isfinite(errors[m]) ? peak / pair.matches[m].chance * std::exp(-0.5 * ratio * ratio)
                                            : 0);
  }
  const double share = RightShare(over);
  return {MixtureGain(over, share), RightProbabilities(over, share)};
}

struct PlacedPair {
  size_t station;
  const CircularMatches::Pair* pair;
};

std::vector<PlacedPair> AllPairs(const std::vector<CircularMatches>& data) {
  std::vector<PlacedPair> pairs;
  for (size_t s = 0; s < data.size(); ++s) {
    for (const CircularMatches::Pair& pair : data[s].pairs) pairs.push_back({s, &pair});
  }
  return pairs;
}

// From several threads, unless they would wait for each other longer than they work.
template <typename Work>
void ForEachPair(const std::vector<PlacedPair>& pairs, const Work& work) {
  size_t num_matches = 0;
  for (const PlacedPair& pair : pairs) num_matches += pair.pair->matches.size();
  ParallelFor(static_cast<int64_t>(pairs.size()), num_matches < kWorthThreads ? 1 : 0,
              [&](int64_t p) { work(static_cast<size_t>(p)); });
}

double AngleSigma(const CircularPriors& priors, size_t station) {
  const std::vector<double>& angles = priors.angles[station].angles;
  const double span = angles.size() > 1 ? std::abs(angles.back() - angles.front()) : 0;
  return std::max(priors.angle_share * span / std::max(1.0, static_cast<double>(angles.size()) - 1), 1e-4);
}

double LogPriors(const CircularPriors& priors, const CircularState& state) {
  double sum = 0;
  for (size_t c = 0; c < state.lenses.size(); ++c) {
    const FocalPrior& focal = priors.focal[c];
    const double off = (state.lenses[c].log_focal - std::log(focal.focal_px)) / focal.sigma_log;
    sum -= 0.5 * off * off;
    if (priors.distortion_sigma > 0) {
      const double bent = (state.lenses[c].distortion - priors.distortion[c]) / priors.distortion_sigma;
      sum -= 0.5 * bent * bent;
    }
  }
  for (size_t s = 0; s < priors.angles.size(); ++s) {
    const double sigma = AngleSigma(priors, s);
    for (size_t i = 0; i < priors.angles[s].angles.size(); ++i) {
      const double off = (state.turns[s].angles[i] - priors.angles[s].angles[i]) / sigma;
      sum -= 0.5 * off * off;
    }
  }
  return sum;
}

// Where the unknowns stand in the normal equations.
class Columns {
 public:
  Columns(const std::vector<CircularMatches>& data, size_t num_lenses, CircularSteps steps) : steps_(steps) {
    int next = 2 * static_cast<int>(num_lenses);
    for (const CircularMatches& station : data) {
      first_.push_back(next);
      next += 3;
      if (steps == CircularSteps::kEqual) next += 1;
      if (steps == CircularSteps::kFree) next += station.num_photos - 1;
    }
    size_ = next;
  }
  int size() const { return size_; }
  int OfTurn(size_t station) const { return first_[station]; }
  int OfStep(size_t station) const { return first_[station] + 3; }
  /// -1 for the first photo, whose angle is 0.
  int OfAngle(size_t station, int photo) const { return photo == 0 ? -1 : first_[station] + 2 + photo; }
  CircularSteps steps() const { return steps_; }

 private:
  CircularSteps steps_;
  std::vector<int> first_;
  int size_ = 0;
};

struct NormalEquations {
  MatrixXd matrix;
  VectorXd right;
};

// J^T W J and -J^T W e, each match by its probability to be right, and the priors.
NormalEquations Linearize(const std::vector<CircularMatches>& data, const CircularPriors& priors,
                          const CircularState& state, const Columns& columns) {
  NormalEquations normal{MatrixXd::Zero(columns.size(), columns.size()), VectorXd::Zero(columns.size())};
  const double information = 1 / (state.sigma_px * state.sigma_px);
  struct PairNormal {
    Matrix6d matrix = Matrix6d::Zero();
    Vector6d right = Vector6d::Zero();
  };
  const std::vector<PlacedPair> pairs = AllPairs(data);
  std::vector<PairNormal> normals(pairs.size());
  ForEachPair(pairs, [&](size_t p) {
    const CircularMatches& station = data[pairs[p].station];
    PairErrors errors;
    ErrorsOf(*pairs[p].pair, station.reach_px, state.lenses[static_cast<size_t>(station.lens)],
             state.turns[pairs[p].station], true, &errors);
    const PairMixture mixture = MixtureOf(*pairs[p].pair, errors.errors, state.sigma_px);
    for (size_t m = 0; m < errors.errors.size(); ++m) {
      if (!std::isfinite(errors.errors[m])) continue;
      const double weight = mixture.right[m] * information;
      if (weight < 1e-6 * information) continue;
      normals[p].matrix.noalias() += weight * errors.derivatives[m] * errors.derivatives[m].transpose();
      normals[p].right -= weight * errors.errors[m] * errors.derivatives[m];
    }
  });
  auto of_pair = normals.begin();
  for (size_t s = 0; s < data.size(); ++s) {
    const CircularMatches& station = data[s];
    for (const CircularMatches::Pair& pair : station.pairs) {
      const auto& [matrix, right] = *of_pair++;
      // The pair's angle is that of its second photo less that of its first.
      std::array<std::pair<int, double>, 7> place;
      size_t used = 0;
      std::array<int, 7> of{};
      const auto put = [&](int column, int local, double factor) {
        if (column < 0 || factor == 0) return;
        place[used] = {column, factor};
        of[used++] = local;
      };
      put(2 * station.lens, 0, 1);
      put(2 * station.lens + 1, 1, 1);
      for (int k = 0; k < 3; ++k) put(columns.OfTurn(s) + k, 2 + k, 1);
      if (columns.steps() == CircularSteps::kEqual) put(columns.OfStep(s), 5, pair.photo2 - pair.photo1);
      if (columns.steps() == CircularSteps::kFree) {
        put(columns.OfAngle(s, pair.photo1), 5, -1);
        put(columns.OfAngle(s, pair.photo2), 5, 1);
      }
      for (size_t a = 0; a < used; ++a) {
        normal.right(place[a].first) += place[a].second * right(of[a]);
        for (size_t b = 0; b < used; ++b) {
          normal.matrix(place[a].first, place[b].first) +=
              place[a].second * place[b].second * matrix(of[a], of[b]);
        }
      }
    }
    if (columns.steps() != CircularSteps::kFree || priors.angles.empty()) continue;
    const double sigma = AngleSigma(priors, s);
    const double of_angle = 1 / (sigma * sigma);
    for (int i = 1; i < station.num_photos; ++i) {
      const int column = columns.OfAngle(s, i);
      normal.matrix(column, column) += of_angle;
      normal.right(column) -= of_angle * (state.turns[s].angles[static_cast<size_t>(i)] -
                                          priors.angles[s].angles[static_cast<size_t>(i)]);
    }
  }
  for (size_t c = 0; c < state.lenses.size(); ++c) {
    const auto at = static_cast<Eigen::Index>(2 * c);
    const FocalPrior& focal = priors.focal[c];
    const double of_focal = 1 / (focal.sigma_log * focal.sigma_log);
    normal.matrix(at, at) += of_focal;
    normal.right(at) -= of_focal * (state.lenses[c].log_focal - std::log(focal.focal_px));
    if (priors.distortion_sigma > 0) {
      const double of_distortion = 1 / (priors.distortion_sigma * priors.distortion_sigma);
      normal.matrix(at + 1, at + 1) += of_distortion;
      normal.right(at + 1) -= of_distortion * (state.lenses[c].distortion - priors.distortion[c]);
    } else {
      normal.matrix.row(at + 1).setZero();
      normal.matrix.col(at + 1).setZero();
      normal.matrix(at + 1, at + 1) = 1;
      normal.right(at + 1) = 0;
    }
  }
  return normal;
}

CircularState Moved(const CircularState& state, const CircularPriors& priors, const Columns& columns,
                    const VectorXd& step) {
  CircularState moved = state;
  for (size_t c = 0; c < moved.lenses.size(); ++c) {
    const auto at = static_cast<Eigen::Index>(2 * c);
    moved.lenses[c].log_focal =
        std::clamp(moved.lenses[c].log_focal + step(at), priors.least_log_focal[c], priors.most_log_focal[c]);
    if (priors.distortion_sigma > 0) moved.lenses[c].distortion += step(at + 1);
  }
  for (size_t s = 0; s < moved.turns.size(); ++s) {
    CircularTurn& turn = moved.turns[s];
    const Vector3d w = step.segment<3>(columns.OfTurn(s));
    turn.frame = ClosestRotation(ExpRotation<double>(w) * turn.frame);
    for (int i = 1; i < static_cast<int>(turn.angles.size()); ++i) {
      double& angle = turn.angles[static_cast<size_t>(i)];
      if (columns.steps() == CircularSteps::kEqual) angle += i * step(columns.OfStep(s));
      if (columns.steps() == CircularSteps::kFree) angle += step(columns.OfAngle(s, i));
    }
  }
  return moved;
}

}  // namespace

CircularFigures EvaluateCircular(const std::vector<CircularMatches>& data, const CircularPriors& priors,
                                 const CircularState& state, bool with_photos) {
  CircularFigures figures;
  figures.log_posterior = LogPriors(priors, state);
  struct PairTerms {
    std::vector<double> errors;
    PairMixture mixture;
  };
  const std::vector<PlacedPair> pairs = AllPairs(data);
  std::vector<PairTerms> terms(pairs.size());
  ForEachPair(pairs, [&](size_t p) {
    const CircularMatches& station = data[pairs[p].station];
    PairErrors errors;
    ErrorsOf(*pairs[p].pair, station.reach_px, state.lenses[static_cast<size_t>(station.lens)],
             state.turns[pairs[p].station], false, &errors);
    terms[p].mixture = MixtureOf(*pairs[p].pair, errors.errors, state.sigma_px);
    terms[p].errors = std::move(errors.errors);
  });
  auto of_pair = terms.begin();
  double squares = 0;
  for (size_t s = 0; s < data.size(); ++s) {
    const CircularMatches& station = data[s];
    figures.gain.push_back(0);
    figures.inliers_of_station.push_back(0);
    if (with_photos) figures.gain_of_photo.emplace_back(static_cast<size_t>(station.num_photos), 0.0);
    for (const CircularMatches::Pair& pair : station.pairs) {
      const auto& [errors, mixture] = *of_pair++;
      figures.gain.back() += mixture.gain;
      for (size_t m = 0; m < errors.size(); ++m) {
        const double right = mixture.right[m];
        if (!(right > 0)) continue;
        figures.inliers += right;
        squares += right * errors[m] * errors[m];
        figures.inliers_of_station.back() += right > 0.5 ? 1 : 0;
      }
      if (with_photos) {
        figures.gain_of_photo.back()[static_cast<size_t>(pair.photo1)] += mixture.gain;
        figures.gain_of_photo.back()[static_cast<size_t>(pair.photo2)] += mixture.gain;
      }
    }
    figures.log_posterior += figures.gain.back();
  }
  figures.sigma_px = std::sqrt(squares / std::max(figures.inliers, 1e-9));
  return figures;
}

CircularFigures RefineCircular(const std::vector<CircularMatches>& data, const CircularPriors& priors,
                               CircularSteps steps, int max_iterations, CircularState* state,
                               std::vector<double>* focal_sigma_log) {
  const Columns columns(data, state->lenses.size(), steps);
  CircularFigures figures = EvaluateCircular(data, priors, *state, false);
  double damping = 1e-3;
  for (int iteration = 0; iteration < max_iterations; ++iteration) {
    const NormalEquations normal = Linearize(data, priors, *state, columns);
    bool has_improved = false;
    double gain = 0;
    for (int attempt = 0; attempt < kMaxAttempts && !has_improved; ++attempt) {
      MatrixXd damped = normal.matrix;
      damped.diagonal() += damping * normal.matrix.diagonal() + VectorXd::Constant(columns.size(), 1e-6);
      const VectorXd step = damped.ldlt().solve(normal.right);
      if (!step.allFinite()) break;
      const CircularState moved = Moved(*state, priors, columns, step);
      const CircularFigures there = EvaluateCircular(data, priors, moved, false);
      if (there.log_posterior > figures.log_posterior) {
        gain = there.log_posterior - figures.log_posterior;
        figures = there;
        *state = moved;
        damping = std::max(damping / 5, 1e-9);
        has_improved = true;
      } else {
        damping *= 5;
      }
    }
    if (!has_improved || gain < 1e-3) break;
  }
  if (focal_sigma_log != nullptr) {
    NormalEquations normal = Linearize(data, priors, *state, columns);
    normal.matrix.diagonal() += VectorXd::Constant(columns.size(), 1e-9);
    const MatrixXd covariance =
        normal.matrix.ldlt().solve(MatrixXd::Identity(columns.size(), columns.size()));
    focal_sigma_log->clear();
    for (size_t c = 0; c < state->lenses.size(); ++c) {
      const auto at = static_cast<Eigen::Index>(2 * c);
      focal_sigma_log->push_back(std::sqrt(std::max(0.0, covariance(at, at))));
    }
  }
  return figures;
}

void FaceMatches(const CircularMatches& station, const CircularLens& lens, double sigma_px,
                 CircularTurn* turn) {
  constexpr double kRightSigmas = 2;  // nineteen of twenty right matches are within
  const double focal = std::exp(lens.log_focal);
  const Vector3d foot = turn->frame.col(0);
  PairErrors errors;
  int64_t in_front = 0;  // less those behind
  for (const CircularMatches::Pair& pair : station.pairs) {
    ErrorsOf(pair, station.reach_px, lens, *turn, false, &errors);
    const double angle =
        turn->angles[static_cast<size_t>(pair.photo2)] - turn->angles[static_cast<size_t>(pair.photo1)];
    const Matrix3d turned = turn->frame * Eigen::AngleAxisd(angle, Vector3d::UnitZ()).toRotationMatrix() *
                            turn->frame.transpose();
    const Vector3d moved = foot - turned * foot;
    for (size_t m = 0; m < pair.matches.size(); ++m) {
      if (!(std::abs(errors.errors[m]) <= kRightSigmas * sigma_px)) continue;
      const Vector3d ray1 = turned * ThroughLens(lens, focal, pair.matches[m].first).ray;
      const Vector3d ray2 = ThroughLens(lens, focal, pair.matches[m].second).ray;
      // depth2 ray2 = depth1 ray1 + moved
      const Vector3d across = ray2.cross(ray1);
      const bool first_is_in_front = across.dot(moved.cross(ray2)) > 0;
      const bool second_is_in_front = across.dot(moved.cross(ray1)) > 0;
      if (first_is_in_front == second_is_in_front) in_front += first_is_in_front ? 1 : -1;
    }
  }
  if (in_front < 0) turn->frame.leftCols<2>() *= -1;
}

}  // namespace s2gs
