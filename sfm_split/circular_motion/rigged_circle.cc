#include "sfm_split/circular_motion/rigged_circle.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <map>
#include <numeric>
#include <utility>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/circular_motion/climb.h"
#include "sfm_split/circular_motion/epipolar_gain.h"
#include "sfm_split/circular_motion/table_views.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kCoarseSigmaPx = 4;     // between points of the grid
constexpr double kGrid = 2 * kDegree;    // of a station's first angle
constexpr double kFineGrid = kDegree;    // of a station that is turned once more
constexpr size_t kNumTurned = 3;         // circles whose stations are turned once more
constexpr size_t kCoarseMatches = 6000;  // that judge the grid
constexpr size_t kNumFirst = 16;         // axes, by the matches inside stations, whose angles are searched
constexpr size_t kNumRefined = 8;        // circles that are refined
constexpr double kCertain = 8;           // e^-8: what is believed against chance, and against another circle
constexpr double kDistinct = 5 * kDegree;  // axes or angles farther apart are two answers
// Some hundred matches, of 50 to 100 ns each: less is over before another thread is awake.
constexpr int64_t kPairsAtOnce = 8;

struct Circle {
  Vector3d direction;
  Vector3d point;             // of the axis, in units of the cameras' distance from it
  std::vector<double> first;  // [rad] per station
  std::vector<int> sense;     // per station: +1 or -1
  double gain = 0;
};

class Rig {
 public:
  Rig(const std::vector<RiggedStation>& stations, const std::vector<RiggedPair>& pairs)
      : stations_(stations), pairs_(pairs) {
    for (const RiggedPair& pair : pairs) num_matches_ += pair.matches.size();
    // A few matches of each pair would say nothing: which of them are right, many together tell.
    const size_t stride = 1 + num_matches_ / kCoarseMatches;
    std::map<std::pair<int, int>, size_t> next;
    for (const RiggedPair& pair : pairs)
      is_coarse_.push_back(next[{pair.station1, pair.station2}]++ % stride == 0);
  }

  size_t num_matches() const { return num_matches_; }

  double GainOf(const RiggedPair& pair, const Circle& circle, double sigma_px) const {
    const RiggedStation& a = stations_[static_cast<size_t>(pair.station1)];
    const RiggedStation& b = stations_[static_cast<size_t>(pair.station2)];
    const double turn = Angle(circle, pair.station2, pair.photo2) - Angle(circle, pair.station1, pair.photo1);
    const Matrix3d rotation = RotationAbout<double>(circle.direction, turn);
    const Rigid3 turned{Eigen::Quaterniond(rotation), circle.point - rotation * circle.point};
    return EpipolarGain(pair.matches, b.cam_from_world * turned * a.cam_from_world.Inverse(), a.focal_px,
                        b.focal_px, sigma_px);
  }

  template <typename Counts>
  double Sum(bool is_coarse, const Circle& circle, double sigma_px, const Counts& counts) const {
    std::vector<double> gains(pairs_.size(), 0);
    Measure(circle, sigma_px, is_coarse, counts, &gains);
    return std::accumulate(gains.begin(), gains.end(), 0.0);
  }

  // Of the matches inside one station, or between it and those before it.
  double GainInside(int station, const Circle& circle, double sigma_px, bool is_coarse) const {
    return Sum(is_coarse, circle, sigma_px,
               [&](const RiggedPair& pair) { return pair.station1 == station && pair.station2 == station; });
  }
  double GainAcross(int station, const Circle& circle, double sigma_px, bool is_coarse) const {
    return Sum(is_coarse, circle, sigma_px, [&](const RiggedPair& pair) {
      return pair.station1 != pair.station2 && std::max(pair.station1, pair.station2) == station;
    });
  }
  // Between one station and all others.
  double GainWithOthers(int station, const Circle& circle, double sigma_px, bool is_coarse) const {
    return Sum(is_coarse, circle, sigma_px, [&](const RiggedPair& pair) {
      return (pair.station1 == station) != (pair.station2 == station);
    });
  }
  double Gain(const Circle& circle, double sigma_px, bool is_coarse) const {
    return Sum(is_coarse, circle, sigma_px, [](const RiggedPair& /*pair*/) { return true; });
  }

  double Angle(const Circle& circle, int station, int photo) const {
    const auto s = static_cast<size_t>(station);
    return circle.first[s] + circle.sense[s] * 2 * kPi / stations_[s].num_photos * photo;
  }

  // Which way each station's photos follow the turn, as the matches inside it say.
  void TakeSenses(Circle* circle) const {
    circle->first.assign(stations_.size(), 0);
    circle->sense.assign(stations_.size(), 1);
    circle->gain = 0;
    for (size_t s = 0; s < stations_.size(); ++s) {
      const double forth = GainInside(static_cast<int>(s), *circle, kCoarseSigmaPx, true);
      circle->sense[s] = -1;
      const double back = GainInside(static_cast<int>(s), *circle, kCoarseSigmaPx, true);
      if (forth >= back) circle->sense[s] = 1;
      circle->gain += std::max(forth, back);
    }
  }

  // At which angle each station begins, and once more which way it goes.
  void TakeFirstAngles(Circle* circle) const {
    for (size_t s = 1; s < stations_.size(); ++s) {
      Circle trial = *circle;
      double best = -1e300;
      for (const int sense : {1, -1}) {
        trial.sense[s] = sense;
        const double inside = GainInside(static_cast<int>(s), trial, kCoarseSigmaPx, true);
        for (double angle = 0; angle < 2 * kPi; angle += kGrid) {
          trial.first[s] = angle;
          const double gain = inside + GainAcross(static_cast<int>(s), trial, kCoarseSigmaPx, true);
          if (gain <= best) continue;
          best = gain;
          circle->first[s] = angle;
          circle->sense[s] = sense;
        }
      }
    }
    circle->gain = Gain(*circle, kCoarseSigmaPx, true);
  }

  // Each station's way and first angle once more, the axis being known better: by all matches inside it, of
  // which few of one pair say nothing.
  void TakeTurns(double sigma_px, Circle* circle) const {
    for (size_t s = 0; s < stations_.size(); ++s) {
      Circle trial = *circle;
      double best = -1e300;
      for (const int sense : {1, -1}) {
        trial.sense[s] = sense;
        const double inside = GainInside(static_cast<int>(s), trial, sigma_px, false);
        for (double angle = 0; angle < 2 * kPi; angle += kFineGrid) {
          trial.first[s] = angle;
          const double gain = inside + GainWithOthers(static_cast<int>(s), trial, sigma_px, true);
          if (gain <= best) continue;
          best = gain;
          circle->first[s] = angle;
          circle->sense[s] = sense;
        }
      }
    }
  }

  // To the top of the likelihood: two numbers of the axis' direction, two of its place, each station's angle.
  void Refine(double sigma_px, bool is_coarse, double first_step, double last_step, Circle* circle) const {
    const auto moved = [](const Circle& from, size_t number, double step) {
      Circle there = from;
      if (number >= 4) {
        there.first[number - 3] += step;
        return there;
      }
      Vector3d across = from.direction.unitOrthogonal();
      if (number % 2 == 1) across = from.direction.cross(across).eval();
      if (number < 2) {
        there.direction = (from.direction + step * across).normalized();
      } else {
        there.point += step * across;
      }
      return there;
    };
    Measured here{*circle, GainsOf(*circle, sigma_px, is_coarse)};
    const auto measured = [&](const Measured& from, size_t number, double step) {
      Measured there{moved(from.circle, number, step), {}};
      if (number < 4) {
        there.gains = GainsOf(there.circle, sigma_px, is_coarse);
      } else {
        there.gains = from.gains;
        MeasureWithOthers(static_cast<int>(number - 3), there.circle, sigma_px, is_coarse, &there.gains);
      }
      return there;
    };
    const auto value = [](const Measured& there) {
      return std::accumulate(there.gains.begin(), there.gains.end(), 0.0);
    };
    const double gain = Climb(3 + stations_.size(), first_step, last_step, measured, value, &here);
    *circle = std::move(here.circle);
    circle->gain = gain;
  }

 private:
  // With what each pair says of it.
  struct Measured {
    Circle circle;
    std::vector<double> gains;
  };

  std::vector<double> GainsOf(const Circle& circle, double sigma_px, bool is_coarse) const {
    std::vector<double> gains(pairs_.size(), 0);
    Measure(
        circle, sigma_px, is_coarse, [](const RiggedPair& /*pair*/) { return true; }, &gains);
    return gains;
  }
  // Of all that a turn of one station changes: what is inside it turns with it.
  void MeasureWithOthers(int station, const Circle& circle, double sigma_px, bool is_coarse,
                         std::vector<double>* gains) const {
    const auto changes = [&](const RiggedPair& pair) {
      return (pair.station1 == station) != (pair.station2 == station);
    };
    Measure(circle, sigma_px, is_coarse, changes, gains);
  }
  template <typename Counts>
  void Measure(const Circle& circle, double sigma_px, bool is_coarse, const Counts& counts,
               std::vector<double>* gains) const {
    ParallelFor(static_cast<int64_t>(pairs_.size()), 0, kPairsAtOnce, [&](int64_t i) {
      const auto p = static_cast<size_t>(i);
      if ((!is_coarse || is_coarse_[p]) && counts(pairs_[p]))
        (*gains)[p] = GainOf(pairs_[p], circle, sigma_px);
    });
  }

  const std::vector<RiggedStation>& stations_;
  const std::vector<RiggedPair>& pairs_;
  size_t num_matches_ = 0;
  std::vector<bool> is_coarse_;  // per pair: counts where many circles are compared
};

// The point nearest to where all stations see what moves; nothing when they see it from one place.
bool FindMiddle(const std::vector<RiggedStation>& stations, const std::vector<RiggedPair>& pairs,
                Vector3d* middle, double* distance) {
  std::vector<Vector3d> sum(stations.size(), Vector3d::Zero());
  for (const RiggedPair& pair : pairs) {
    for (const RayMatch& match : pair.matches) {
      sum[static_cast<size_t>(pair.station1)] += match.first;
      sum[static_cast<size_t>(pair.station2)] += match.second;
    }
  }
  Matrix3d normal = Matrix3d::Zero();
  Vector3d right = Vector3d::Zero();
  for (size_t s = 0; s < stations.size(); ++s) {
    if (sum[s].z() <= 0) continue;
    const Vector3d ray = (stations[s].cam_from_world.rotation.inverse() * sum[s]).normalized();
    const Matrix3d across = Matrix3d::Identity() - ray * ray.transpose();
    normal += across;
    right += across * CameraCentre(stations[s].cam_from_world);
  }
  const Eigen::SelfAdjointEigenSolver<Matrix3d> eigen(normal);
  // Rays that meet at an angle a leave 1 - cos(a) along their mean: below a degree they do not meet.
  if (!(eigen.eigenvalues()(0) > 1 - std::cos(kDegree))) return false;
  *middle = normal.ldlt().solve(right);
  *distance = 0;
  for (const RiggedStation& station : stations)
    *distance +=
        (CameraCentre(station.cam_from_world) - *middle).norm() / static_cast<double>(stations.size());
  return *distance > 0 && middle->allFinite();
}

// Axes through and beside the middle, as a camera upright, on its side or on its head would look down at
// them.
std::vector<Circle> StartingAxes(const RiggedStation& station, const Vector3d& middle) {
  std::vector<Circle> axes;
  for (const Vector2d& up : UpDirections()) {
    for (const double elevation_deg : kElevationsDeg) {
      Circle circle;
      circle.direction =
          station.cam_from_world.rotation.inverse() * AxisInCamera(up, elevation_deg * kDegree);
      const Vector3d sideways = circle.direction.unitOrthogonal();
      for (const double x : {-0.06, 0.0, 0.06}) {
        for (const double y : {-0.06, 0.0, 0.06}) {
          circle.point = middle + x * sideways + y * circle.direction.cross(sideways);
          axes.push_back(circle);
        }
      }
    }
  }
  return axes;
}

void KeepBest(size_t num, std::vector<Circle>* circles) {
  std::stable_sort(circles->begin(), circles->end(),
                   [](const Circle& a, const Circle& b) { return a.gain > b.gain; });
  if (circles->size() > num) circles->resize(num);
}

// Calls work(circle) for all of them: each on a thread of its own, or, where they are fewer than the threads,
// one after the other, whose pairs the threads then share. The same bits.
template <typename Work>
void ForCircles(const Work& work, std::vector<Circle>* circles) {
  const auto count = static_cast<int64_t>(circles->size());
  ParallelFor(count, count < NumThreadsOf(0) ? 1 : 0,
              [&](int64_t k) { work(static_cast<size_t>(k), &(*circles)[static_cast<size_t>(k)]); });
}

// Whether two circles are one: the opposite axis and turn are the same.
bool IsSame(const Circle& a, const Circle& b) {
  const double cosine = a.direction.dot(b.direction);
  if (std::abs(cosine) < std::cos(kDistinct)) return false;
  const int flip = cosine > 0 ? 1 : -1;
  for (size_t s = 0; s < a.first.size(); ++s) {
    if (a.sense[s] != flip * b.sense[s]) return false;
    if (std::abs(WrapAngle(a.first[s] - flip * b.first[s])) > kDistinct) return false;
  }
  return true;
}

}  // namespace

std::vector<RiggedCircle> FitRiggedCircles(const std::vector<RiggedStation>& given,
                                           const std::vector<RiggedPair>& pairs, double extent_px,
                                           double sigma_px, Reporter& reporter) {
  Vector3d middle;
  double distance = 0;
  if (given.size() < 2 || !FindMiddle(given, pairs, &middle, &distance)) return {};
  // The cameras' distance from the middle is the unit of length, the middle its origin.
  std::vector<RiggedStation> stations = given;
  for (RiggedStation& station : stations) {
    station.cam_from_world.translation =
        (station.cam_from_world.translation + station.cam_from_world.rotation * middle) / distance;
  }
  const Rig rig(stations, pairs);
  std::vector<Circle> circles = StartingAxes(stations[0], Vector3d::Zero());
  ForCircles([&](size_t /*k*/, Circle* circle) { rig.TakeSenses(circle); }, &circles);
  KeepBest(kNumFirst, &circles);
  if (reporter.StopRequested()) throw Interrupted();
  ForCircles([&](size_t /*k*/, Circle* circle) { rig.TakeFirstAngles(circle); }, &circles);
  KeepBest(kNumRefined, &circles);
  if (reporter.StopRequested()) throw Interrupted();
  ForCircles(
      [&](size_t /*k*/, Circle* circle) {
        rig.Refine(kCoarseSigmaPx, true, 0.05, 0.003, circle);
        rig.Refine(2 * sigma_px, true, 0.01, 0.001, circle);
      },
      &circles);
  KeepBest(kNumTurned, &circles);
  if (reporter.StopRequested()) throw Interrupted();
  // As they are, and with other turns of the stations.
  const size_t num = circles.size();
  for (size_t k = 0; k < num; ++k) circles.push_back(circles[k]);
  ForCircles(
      [&](size_t k, Circle* circle) {
        if (k >= num) rig.TakeTurns(2 * sigma_px, circle);
        rig.Refine(sigma_px, false, 0.005, 1e-4, circle);
      },
      &circles);
  KeepBest(circles.size(), &circles);
  const double unknowns = 3.0 + static_cast<double>(stations.size());
  const double least_gain =
      0.5 * unknowns * std::log(static_cast<double>(std::max<size_t>(2, rig.num_matches()))) + kCertain;
  // Where wrong matches are thought to be rare, a few make a circle: none is believed that needs this.
  std::vector<RiggedPair> even = pairs;
  for (RiggedPair& pair : even) {
    for (RayMatch& match : pair.matches) match.chance = std::max(match.chance, 1 / extent_px);
  }
  const Rig even_rig(stations, even);
  std::vector<RiggedCircle> result;
  std::vector<Circle> kept;
  for (const Circle& circle : circles) {
    const bool is_known =
        std::any_of(kept.begin(), kept.end(), [&](const Circle& other) { return IsSame(circle, other); });
    if (is_known || even_rig.Gain(circle, sigma_px, false) <= least_gain) continue;
    kept.push_back(circle);
    RiggedCircle& found = result.emplace_back();
    found.gain = circle.gain;
    found.axis.direction = circle.direction;
    found.axis.point = middle + distance * circle.point;
    for (size_t s = 0; s < stations.size(); ++s) {
      std::vector<double>& angles = found.angle_rad.emplace_back();
      for (int i = 0; i < stations[s].num_photos; ++i)
        angles.push_back(rig.Angle(circle, static_cast<int>(s), i) - circle.first[0]);
    }
  }
  return result;
}

}  // namespace s2gs
