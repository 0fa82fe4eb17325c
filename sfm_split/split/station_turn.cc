#include "sfm_split/split/station_turn.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/base/sampson_error.h"
#include "sfm_split/split/two_view_motion.h"

namespace s2gs {
namespace {

constexpr size_t kSearchMatches = 240;    // that rank the starting points
constexpr size_t kFitMatches = 3000;      // that the fit uses
constexpr size_t kMinSearchMatches = 30;  // for five parameters: six for each
constexpr size_t kNumRefined = 12;        // starting points that are refined
constexpr int kMaxIterations = 40;        // of Gauss and Newton
constexpr double kSlack = 2;  // errors of a family fitted to many pairs, over those of one pair's fit
constexpr double kAngleSlackRad = 8 * kPi / 180;  // between an angle alone and what the family says of it ...
constexpr double kAngleSlackShare = 0.1;  // ... and so much of the angle: a debt, chosen and not derived
constexpr double kLeastFocal = 0.3;       // of the longest side
constexpr double kLargestFocal = 10;      // of the longest side: a lens of 360 mm before 36 mm
constexpr double kFitsShare = 0.5;        // of a pair's matches that must follow its angle
constexpr double kFitsOverBest = 0.8;     // or of the matches that follow the best angle

// log(focal / longest side), elevation, roll, offset of the foot, step.
using Parameters = Eigen::Matrix<double, 5, 1>;

StationTurn ToTurn(const Parameters& p, const Eigen::Vector2i& size) {
  StationTurn turn;
  turn.focal_px = std::exp(p[0]) * size.maxCoeff();
  turn.principal_point = 0.5 * size.cast<double>();
  const Eigen::Vector3d up(0, -std::cos(p[1]), -std::sin(p[1]));
  turn.axis = Eigen::AngleAxisd(p[2], Eigen::Vector3d::UnitZ()) * up;
  const Eigen::Vector3d z = Eigen::Vector3d::UnitZ();
  Eigen::Vector3d towards = z - z.dot(turn.axis) * turn.axis;
  if (towards.norm() < 1e-6) towards = turn.axis.unitOrthogonal();
  turn.foot = Eigen::AngleAxisd(p[3], turn.axis) * towards.normalized();
  turn.step_rad = p[4];
  return turn;
}

struct Match {
  int steps;
  Eigen::Vector2f xy1;
  Eigen::Vector2f xy2;
};

// Signed Sampson errors, divided by the bound.
void Errors(const Parameters& p, const Eigen::Vector2i& size, const std::vector<Match>& matches,
            double max_error_px, Eigen::VectorXd* errors) {
  const StationTurn turn = ToTurn(p, size);
  errors->resize(static_cast<Eigen::Index>(matches.size()));
  int steps = 0;
  Eigen::Matrix3d F = Eigen::Matrix3d::Zero();
  for (size_t m = 0; m < matches.size(); ++m) {
    if (m == 0 || matches[m].steps != steps) {
      steps = matches[m].steps;
      F = turn.Fundamental(steps * turn.step_rad);
    }
    const double error = SampsonError<double>(F, matches[m].xy1.cast<double>().homogeneous(),
                                              matches[m].xy2.cast<double>().homogeneous());
    (*errors)[static_cast<Eigen::Index>(m)] = error / max_error_px;
  }
}

// Geman and McClure's cost: outliers cost 1, whatever their error.
double Cost(const Eigen::VectorXd& errors) {
  double cost = 0;
  for (const double e : errors) cost += e * e / (1 + e * e);
  return cost;
}

double Refine(const Eigen::Vector2i& size, const std::vector<Match>& matches, double max_error_px,
              const std::array<bool, 5>& is_free, Parameters* p) {
  Eigen::VectorXd errors;
  Eigen::VectorXd moved;
  Errors(*p, size, matches, max_error_px, &errors);
  double cost = Cost(errors);
  double damping = 1e-2;
  for (int iteration = 0; iteration < kMaxIterations; ++iteration) {
    Eigen::Matrix<double, Eigen::Dynamic, 5> jacobian =
        Eigen::Matrix<double, Eigen::Dynamic, 5>::Zero(errors.size(), 5);
    for (int c = 0; c < 5; ++c) {
      if (!is_free[c]) continue;
      // A judgement between rounding and curvature: the numbers are of order 1.
      constexpr double kDelta = 1e-6;
      Parameters q = *p;
      q[c] += kDelta;
      Errors(q, size, matches, max_error_px, &moved);
      jacobian.col(c) = (moved - errors) / kDelta;
    }
    const Eigen::VectorXd weights = (1 + errors.array().square()).square().inverse();
    const Eigen::Matrix<double, 5, 5> hessian = jacobian.transpose() * weights.asDiagonal() * jacobian;
    const Parameters gradient = jacobian.transpose() * weights.asDiagonal() * errors;
    bool has_improved = false;
    double gain = 0;
    for (int attempt = 0; attempt < 6 && !has_improved; ++attempt) {
      Eigen::Matrix<double, 5, 5> damped = hessian;
      damped.diagonal() += damping * (hessian.diagonal() + Parameters::Constant(1e-9));
      Parameters q = *p - damped.ldlt().solve(gradient);
      q[0] = std::clamp(q[0], std::log(kLeastFocal), std::log(kLargestFocal));
      if (!q.allFinite()) break;
      Errors(q, size, matches, max_error_px, &moved);
      const double new_cost = Cost(moved);
      if (new_cost < cost) {
        gain = cost - new_cost;
        cost = new_cost;
        *p = q;
        errors = moved;
        damping = std::max(damping / 5, 1e-9);
        has_improved = true;
      } else {
        damping *= 5;
      }
    }
    if (!has_improved || gain < 1e-6 * cost) break;
  }
  return cost;
}

// Every k-th match, sorted by steps.
std::vector<Match> Sample(const std::vector<TurnMatches>& pairs, size_t num) {
  size_t total = 0;
  for (const TurnMatches& pair : pairs) total += pair.xy1.size();
  const size_t stride = std::max<size_t>(1, total / num);
  std::vector<Match> sample;
  sample.reserve(total / stride + 1);
  size_t at = 0;
  for (const TurnMatches& pair : pairs) {
    for (size_t m = 0; m < pair.xy1.size(); ++m) {
      if (at++ % stride == 0) sample.push_back({pair.steps, pair.xy1[m], pair.xy2[m]});
    }
  }
  std::stable_sort(sample.begin(), sample.end(),
                   [](const Match& a, const Match& b) { return a.steps < b.steps; });
  return sample;
}

int CountInliers(const StationTurn& turn, const TurnMatches& pair, double theta, double bound) {
  const Eigen::Matrix3d F = turn.Fundamental(theta);
  int count = 0;
  for (size_t m = 0; m < pair.xy1.size(); ++m)
    count += SampsonErrorPx(F, pair.xy1[m], pair.xy2[m]) <= bound ? 1 : 0;
  return count;
}

double InlierShare(const StationTurn& turn, const std::vector<TurnMatches>& pairs, double max_error_px) {
  double inliers = 0;
  double all = 0;
  for (const TurnMatches& pair : pairs) {
    inliers += CountInliers(turn, pair, pair.steps * turn.step_rad, kSlack * max_error_px);
    all += static_cast<double>(pair.xy1.size());
  }
  return all > 0 ? inliers / all : 0;
}

// A focal length that runs to the search's bounds is not known: without perspective, the table may as well
// turn the other way.
bool HasSensibleFocal(const StationTurn& turn, const Eigen::Vector2i& size) {
  const double ratio = turn.focal_px / size.maxCoeff();
  return ratio > 1.1 * kLeastFocal && ratio < kLargestFocal / 1.1;
}

// \param focal_px  where given, it is exact.
// \param step_rad  where given, the step but for its sense.
std::optional<StationTurn> FitFamily(const std::vector<TurnMatches>& pairs, const Eigen::Vector2i& size,
                                     double max_error_px, double min_inlier_share,
                                     std::optional<double> focal_px, std::optional<double> step_rad) {
  const std::vector<Match> few = Sample(pairs, kSearchMatches);
  if (few.size() < kMinSearchMatches) return std::nullopt;
  const std::vector<Match> many = Sample(pairs, kFitMatches);
  const std::array<bool, 5> is_free = {!focal_px, true, true, true, !step_rad};
  std::vector<double> focals = {0.8, 1.3, 2.5};  // longest sides
  if (focal_px) focals = {*focal_px / size.maxCoeff()};
  std::vector<double> steps;
  if (step_rad) {
    steps = {*step_rad};
  } else {
    for (const double degrees : {1.5, 3.0, 6.0, 10.0, 15.0, 20.0, 30.0, 40.0, 60.0, 90.0, 120.0})
      steps.push_back(degrees * kPi / 180);
  }
  std::vector<std::pair<double, Parameters>> starts;
  Eigen::VectorXd errors;
  for (const double focal : focals) {
    for (const double elevation_deg : {5.0, 20.0, 40.0, 60.0, 80.0}) {
      for (const double step : steps) {
        for (const double sign : {-1.0, 1.0}) {
          Parameters p;
          p << std::log(focal), elevation_deg * kPi / 180, 0, 0, sign * step;
          Errors(p, size, few, 4 * max_error_px, &errors);
          starts.emplace_back(Cost(errors), p);
        }
      }
    }
  }
  std::sort(starts.begin(), starts.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
  starts.resize(std::min(starts.size(), kNumRefined));
  for (auto& [cost, p] : starts) {
    Refine(size, few, 4 * max_error_px, is_free, &p);
    cost = Refine(size, few, max_error_px, is_free, &p);
  }
  Parameters best = std::min_element(starts.begin(), starts.end(), [](const auto& a, const auto& b) {
                      return a.first < b.first;
                    })->second;
  Refine(size, many, max_error_px, is_free, &best);
  StationTurn turn = ToTurn(best, size);
  turn.inlier_share = InlierShare(turn, pairs, max_error_px);
  if (turn.inlier_share < min_inlier_share) return std::nullopt;
  return turn;
}

}  // namespace

Eigen::Matrix3d StationTurn::Fundamental(double theta_rad) const {
  const Eigen::Matrix3d R = Eigen::AngleAxisd(theta_rad, axis).toRotationMatrix();
  const Eigen::Vector3d t = foot - R * foot;
  Eigen::Matrix3d to_ray;
  to_ray << 1 / focal_px, 0, -principal_point.x() / focal_px, 0, 1 / focal_px,
      -principal_point.y() / focal_px, 0, 0, 1;
  return to_ray.transpose() * CrossMatrix<double>(t) * R * to_ray;
}

std::optional<StationTurn> FitStationTurn(const std::vector<TurnMatches>& pairs, int num_photos,
                                          const Eigen::Vector2i& size, double max_error_px,
                                          double min_inlier_share, std::optional<double> focal_px) {
  std::vector<TurnMatches> inside;
  std::vector<TurnMatches> across;  // the end of a full turn
  for (const TurnMatches& pair : pairs) {
    if (2 * std::abs(pair.steps) <= num_photos) {
      inside.push_back(pair);
    } else {
      across.push_back(pair);
      across.back().steps -= pair.steps > 0 ? num_photos : -num_photos;
    }
  }
  if (!across.empty()) {
    std::vector<TurnMatches> all = inside;
    all.insert(all.end(), across.begin(), across.end());
    auto turn = FitFamily(all, size, max_error_px, min_inlier_share, focal_px, 2 * kPi / num_photos);
    if (turn && HasSensibleFocal(*turn, size) &&
        InlierShare(*turn, across, max_error_px) >= min_inlier_share) {
      turn->is_full_turn = true;
      return turn;
    }
  }
  return FitFamily(inside, size, max_error_px, min_inlier_share, focal_px, std::nullopt);
}

bool FitsItsAngle(const StationTurn& turn, const TurnMatches& pair, double max_error_px) {
  constexpr double kGrid = kPi / 180;  // [rad] finer than kAngleSlackRad
  const double bound = kSlack * max_error_px;
  const double expected = std::remainder(pair.steps * turn.step_rad, 2 * kPi);
  const double slack = kAngleSlackRad + kAngleSlackShare * std::abs(expected);
  int best = 0;
  int at_expected = 0;
  for (double theta = -kPi; theta < kPi; theta += kGrid) {
    if (std::abs(theta) < kGrid) continue;
    const int count = CountInliers(turn, pair, theta, bound);
    best = std::max(best, count);
    if (std::abs(std::remainder(theta - expected, 2 * kPi)) <= slack)
      at_expected = std::max(at_expected, count);
  }
  return at_expected >= kFitsShare * static_cast<double>(pair.xy1.size()) &&
         at_expected >= kFitsOverBest * best;
}

}  // namespace s2gs
