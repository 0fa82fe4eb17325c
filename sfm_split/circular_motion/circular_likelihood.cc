#include "sfm_split/circular_motion/circular_likelihood.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>

#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/circular_motion/circular_errors.h"
#include "sfm_split/circular_motion/circular_lens.h"
#include "sfm_split/circular_motion/match_mixture.h"
#include "sfm_split/circular_motion/match_triples.h"
#include "sfm_split/solvers/eigen_solvers.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::VectorXd;

constexpr size_t kWorthThreads = 5000;  // matches: some .5 ms
constexpr int kMaxAttempts = 8;         // of one step, with ever more damping

// At the share of right matches of a pair or row that makes its likelihood greatest.
struct Mixture {
  double gain = 0;
  std::vector<double> right;  // probability of each match
};

// \param sigma_px  of a right one's error.
template <typename Match>
Mixture MixtureOf(const std::vector<Match>& matches, const std::vector<double>& errors, double sigma_px) {
  std::vector<double> over;  // density of a right match's error over that of a wrong one's
  over.reserve(errors.size());
  const double peak = 1 / (sigma_px * kRootTwoPi);
  for (size_t m = 0; m < errors.size(); ++m) {
    const double ratio = errors[m] / sigma_px;
    over.push_back(std::isfinite(errors[m]) ? OverChance(peak / matches[m].chance, -0.5 * ratio * ratio) : 0);
  }
  const double share = RightShare(over);
  return {MixtureGain(over, share), RightProbabilities(over, share)};
}

// A pair or row of a station.
template <typename Part>
struct Placed {
  size_t station;
  const Part* part;
};

template <typename Part>
std::vector<Placed<Part>> AllOf(const std::vector<CircularMatches>& data,
                                std::vector<Part> CircularMatches::*parts) {
  std::vector<Placed<Part>> all;
  for (size_t s = 0; s < data.size(); ++s) {
    for (const Part& part : data[s].*parts) all.push_back({s, &part});
  }
  return all;
}

size_t NumMatches(const CircularMatches::Pair& pair) { return pair.matches.size(); }
size_t NumMatches(const CircularMatches::Row& row) { return row.triples.size(); }

// From several threads, unless they would wait for each other longer than they work.
template <typename Part, typename Work>
void ForEach(const std::vector<Placed<Part>>& all, const Work& work) {
  size_t num_matches = 0;
  for (const Placed<Part>& one : all) num_matches += NumMatches(*one.part);
  ParallelFor(static_cast<int64_t>(all.size()), num_matches < kWorthThreads ? 1 : 0,
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
    sum += priors.focal[c].LogDensity(state.lenses[c].log_focal);
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

// J^T W J and -J^T W e of a pair's or row's own unknowns: log focal length, distortion, turn of the frame,
// angles.
template <int kSize>
struct LocalNormal {
  Eigen::Matrix<double, kSize, kSize> matrix = Eigen::Matrix<double, kSize, kSize>::Zero();
  Eigen::Matrix<double, kSize, 1> right = Eigen::Matrix<double, kSize, 1>::Zero();
};

// Each match by its probability to be right.
template <int kSize>
LocalNormal<kSize> WeighErrors(const std::vector<double>& errors,
                               const std::vector<Eigen::Matrix<double, kSize, 1>>& derivatives,
                               const Mixture& mixture, double sigma_px) {
  const double information = 1 / (sigma_px * sigma_px);
  LocalNormal<kSize> normal;
  for (size_t m = 0; m < errors.size(); ++m) {
    if (!std::isfinite(errors[m])) continue;
    const double weight = mixture.right[m] * information;
    if (weight < 1e-6 * information) continue;
    normal.matrix.noalias() += weight * derivatives[m] * derivatives[m].transpose();
    normal.right -= weight * errors[m] * derivatives[m];
  }
  return normal;
}

// Where one of a pair's or row's own unknowns stands, and how it follows the one there.
struct Place {
  int column;
  int local;
  double factor;
};

std::vector<Place> PlacesOf(const Columns& columns, size_t station, int lens, const int* photos,
                            int num_photos) {
  std::vector<Place> places = {{2 * lens, 0, 1}, {2 * lens + 1, 1, 1}};
  for (int k = 0; k < 3; ++k) places.push_back({columns.OfTurn(station) + k, 2 + k, 1});
  // An angle is that of the later photo less that of the earlier.
  for (int k = 0; k + 1 < num_photos; ++k) {
    if (columns.steps() == CircularSteps::kEqual)
      places.push_back({columns.OfStep(station), 5 + k, static_cast<double>(photos[k + 1] - photos[k])});
    if (columns.steps() != CircularSteps::kFree) continue;
    for (const int later : {0, 1}) {
      const int column = columns.OfAngle(station, photos[k + later]);
      if (column >= 0) places.push_back({column, 5 + k, later == 1 ? 1.0 : -1.0});
    }
  }
  return places;
}

template <int kSize>
void Add(const LocalNormal<kSize>& local, const std::vector<Place>& places, NormalEquations* normal) {
  for (const Place& a : places) {
    normal->right(a.column) += a.factor * local.right(a.local);
    for (const Place& b : places)
      normal->matrix(a.column, b.column) += a.factor * b.factor * local.matrix(a.local, b.local);
  }
}

void AddPairs(const std::vector<CircularMatches>& data, const CircularState& state, const Columns& columns,
              NormalEquations* normal) {
  const auto pairs = AllOf(data, &CircularMatches::pairs);
  std::vector<LocalNormal<6>> normals(pairs.size());
  ForEach(pairs, [&](size_t p) {
    const CircularMatches& station = data[pairs[p].station];
    PairErrors errors;
    ErrorsOf(*pairs[p].part, station.reach_px, state.lenses[static_cast<size_t>(station.lens)],
             state.turns[pairs[p].station], true, &errors);
    normals[p] =
        WeighErrors<6>(errors.errors, errors.derivatives,
                       MixtureOf(pairs[p].part->matches, errors.errors, state.sigma_px), state.sigma_px);
  });
  for (size_t p = 0; p < pairs.size(); ++p) {
    const std::array<int, 2> photos = {pairs[p].part->photo1, pairs[p].part->photo2};
    Add(normals[p], PlacesOf(columns, pairs[p].station, data[pairs[p].station].lens, photos.data(), 2),
        normal);
  }
}

void AddRows(const std::vector<CircularMatches>& data, const CircularState& state, const Columns& columns,
             NormalEquations* normal) {
  const auto rows = AllOf(data, &CircularMatches::rows);
  std::vector<LocalNormal<7>> normals(rows.size());
  const double sigma_px = kNoiseOfMiddle * state.sigma_px;
  ForEach(rows, [&](size_t r) {
    RowErrors errors;
    ErrorsOf(*rows[r].part, state.lenses[static_cast<size_t>(data[rows[r].station].lens)],
             state.turns[rows[r].station], true, &errors);
    normals[r] = WeighErrors<7>(errors.errors, errors.derivatives,
                                MixtureOf(rows[r].part->triples, errors.errors, sigma_px), sigma_px);
  });
  for (size_t r = 0; r < rows.size(); ++r) {
    const int lens = data[rows[r].station].lens;
    Add(normals[r], PlacesOf(columns, rows[r].station, lens, rows[r].part->photos.data(), 3), normal);
  }
}

// Of everything, and the priors.
NormalEquations Linearize(const std::vector<CircularMatches>& data, const CircularPriors& priors,
                          const CircularState& state, const Columns& columns) {
  NormalEquations normal{MatrixXd::Zero(columns.size(), columns.size()), VectorXd::Zero(columns.size())};
  AddPairs(data, state, columns, &normal);
  AddRows(data, state, columns, &normal);
  for (size_t s = 0; s < data.size(); ++s) {
    if (columns.steps() != CircularSteps::kFree || priors.angles.empty()) continue;
    const double sigma = AngleSigma(priors, s);
    const double of_angle = 1 / (sigma * sigma);
    for (int i = 1; i < data[s].num_photos; ++i) {
      const int column = columns.OfAngle(s, i);
      normal.matrix(column, column) += of_angle;
      normal.right(column) -= of_angle * (state.turns[s].angles[static_cast<size_t>(i)] -
                                          priors.angles[s].angles[static_cast<size_t>(i)]);
    }
  }
  for (size_t c = 0; c < state.lenses.size(); ++c) {
    const auto at = static_cast<Eigen::Index>(2 * c);
    const FocalNormal& focal = priors.focal[c].At(state.lenses[c].log_focal);
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

double GainOfRows(const std::vector<CircularMatches>& data, const CircularState& state) {
  const auto rows = AllOf(data, &CircularMatches::rows);
  std::vector<double> gains(rows.size());
  ForEach(rows, [&](size_t r) {
    RowErrors errors;
    ErrorsOf(*rows[r].part, state.lenses[static_cast<size_t>(data[rows[r].station].lens)],
             state.turns[rows[r].station], false, &errors);
    gains[r] = MixtureOf(rows[r].part->triples, errors.errors, kNoiseOfMiddle * state.sigma_px).gain;
  });
  return std::accumulate(gains.begin(), gains.end(), 0.0);
}

}  // namespace

CircularFigures EvaluateCircular(const std::vector<CircularMatches>& data, const CircularPriors& priors,
                                 const CircularState& state, bool with_photos) {
  CircularFigures figures;
  figures.log_posterior = LogPriors(priors, state);
  struct PairTerms {
    std::vector<double> errors;
    Mixture mixture;
  };
  const auto pairs = AllOf(data, &CircularMatches::pairs);
  std::vector<PairTerms> terms(pairs.size());
  ForEach(pairs, [&](size_t p) {
    const CircularMatches& station = data[pairs[p].station];
    PairErrors errors;
    ErrorsOf(*pairs[p].part, station.reach_px, state.lenses[static_cast<size_t>(station.lens)],
             state.turns[pairs[p].station], false, &errors);
    terms[p].mixture = MixtureOf(pairs[p].part->matches, errors.errors, state.sigma_px);
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
  figures.log_posterior += GainOfRows(data, state);
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

CircularFigures SettleCircular(const std::vector<CircularMatches>& data, const CircularPriors& priors,
                               CircularSteps steps, double most_sigma_px, CircularState* state) {
  for (int round = 0; round < 6; ++round) {
    const CircularFigures figures = RefineCircular(data, priors, steps, 25, state, nullptr);
    const double sigma = std::clamp(figures.sigma_px, kLeastSigmaPx, most_sigma_px);
    const bool is_settled = std::abs(sigma - state->sigma_px) <= 0.01 * state->sigma_px;
    state->sigma_px = sigma;
    if (is_settled) break;
  }
  return EvaluateCircular(data, priors, *state, false);
}

double FreeCircularAngles(const std::vector<CircularMatches>& data, CircularPriors priors,
                          double most_sigma_px, CircularState* state) {
  priors.angles = state->turns;
  state->sigma_px = most_sigma_px;
  RefineCircular(data, priors, CircularSteps::kFree, 15, state, nullptr);
  const CircularFigures freed = SettleCircular(data, priors, CircularSteps::kFree, most_sigma_px, state);
  double unknowns = 0;
  for (const CircularMatches& station : data) unknowns += station.num_photos - 1;
  return freed.log_posterior - 0.5 * unknowns * std::log(std::max(2.0, freed.inliers));
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
