#include "sfm_split/relocalise/ascent_pair.h"

#include <ceres/jet.h>

#include <algorithm>
#include <cmath>
#include <type_traits>

#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/base/sampson_error.h"
#include "sfm_split/circular_motion/match_mixture.h"

namespace s2gs {
namespace {

using Jet = ceres::Jet<double, kAscentOfPair>;
template <typename T>
using Vector = Eigen::Matrix<T, 3, 1>;
template <typename T>
using Matrix = Eigen::Matrix<T, 3, 3>;

// A pair's number and, as a jet, its own derivative.
template <typename T>
T Number(double value, int place);
template <>
double Number<double>(double value, int /*place*/) {
  return value;
}
template <>
Jet Number<Jet>(double value, int place) {
  return Jet(value, place);
}

template <typename T>
struct Pose {
  Matrix<T> rotation;
  Vector<T> translation;
};

// cam_from_world after a small turn and shift, then about the axis by the station's turn and the photo's
// angle where the object is looked at.
template <typename T>
Pose<T> PoseOf(const AscentStation& station, const TurntableAxis& axis, double angle_rad, bool is_object,
               int first) {
  Vector<T> turn;
  Vector<T> shift;
  for (int k = 0; k < 3; ++k) {
    turn(k) = Number<T>(0, first + k);
    shift(k) = Number<T>(station.cam_from_world.translation(k), first + 3 + k);
  }
  const Matrix<T> rotation =
      ExpRotation<T>(turn) * station.cam_from_world.rotation.toRotationMatrix().cast<T>();
  if (!is_object) return {rotation, shift};
  const Matrix<T> about = RotationAbout<T>(Vector<T>(axis.direction.cast<T>()),
                                           Number<T>(angle_rad + station.turn_rad, first + 6));
  const Vector<T> point = axis.point.cast<T>();
  return {rotation * about, shift + rotation * Vector<T>(point - about * point)};
}

// The errors of a pair's matches [px]; as jets, with how they change with the pair's numbers.
template <typename T>
std::vector<T> ErrorsOf(const AscentPair& pair, const AscentState& state, const TurntableAxis& axis) {
  const Pose<T> first =
      PoseOf<T>(state.stations[static_cast<size_t>(pair.station1)], axis, pair.angle1_rad, pair.is_object, 0);
  const Pose<T> second = PoseOf<T>(state.stations[static_cast<size_t>(pair.station2)], axis, pair.angle2_rad,
                                   pair.is_object, kAscentOfStation);
  using std::exp;
  const T focal1 = exp(Number<T>(state.log_focal[static_cast<size_t>(pair.camera1)], 2 * kAscentOfStation));
  const T focal2 =
      exp(Number<T>(state.log_focal[static_cast<size_t>(pair.camera2)], 2 * kAscentOfStation + 1));
  const Matrix<T> rotation = second.rotation * first.rotation.transpose();
  const Vector<T> translation = second.translation - rotation * first.translation;
  Matrix<T> f = CrossMatrix<T>(translation) * rotation;
  // Of pixels from the principal points.
  f.template leftCols<2>() /= focal1;
  f.template topRows<2>() /= focal2;
  std::vector<T> errors;
  errors.reserve(pair.matches.size());
  for (const auto& [xy1, xy2] : pair.matches)
    errors.push_back(SampsonError<T>(f, xy1.homogeneous(), xy2.homogeneous()));
  return errors;
}

template <typename T>
using PairSum = std::conditional_t<std::is_same_v<T, Jet>, AscentStep, AscentValue>;

// MixtureGain, each match as often as it counts.
double GainOf(const AscentPair& pair, const std::vector<double>& over, double share) {
  if (pair.weight.empty()) return MixtureGain(over, share);
  double gain = 0;
  for (size_t m = 0; m < over.size(); ++m) gain += pair.weight[m] * std::log(1 - share + share * over[m]);
  return gain;
}

template <typename T>
PairSum<T> SumOf(const AscentPair& pair, const AscentState& state, const TurntableAxis& axis,
                 double sigma_px) {
  PairSum<T> sum;
  const std::vector<T> errors = ErrorsOf<T>(pair, state, axis);
  const double peak = 1 / (sigma_px * kRootTwoPi);
  std::vector<double> over;
  over.reserve(errors.size());
  const auto value_of = [](const auto& error) {
    if constexpr (std::is_same_v<T, double>) {
      return error;
    } else {
      return error.a;
    }
  };
  for (size_t m = 0; m < errors.size(); ++m) {
    const double ratio = value_of(errors[m]) / sigma_px;
    over.push_back(OverChance(peak / pair.chance[m], -0.5 * ratio * ratio));
  }
  const double share = RightShare(over);
  sum.value = GainOf(pair, over, share);
  for (size_t m = 0; m < errors.size(); ++m) {
    const double probability = RightProbability(over[m], share);
    if (!(probability > 0)) continue;
    const double counts = pair.weight.empty() ? 1 : pair.weight[m];
    sum.inliers += counts * probability;
    sum.squares += counts * probability * value_of(errors[m]) * value_of(errors[m]);
    if constexpr (std::is_same_v<T, Jet>) {
      if (!errors[m].v.allFinite()) continue;
      const double weight = counts * probability / (sigma_px * sigma_px);
      sum.normal.noalias() += weight * errors[m].v * errors[m].v.transpose();
      sum.right -= weight * errors[m].a * errors[m].v;
    }
  }
  return sum;
}

template <typename T>
std::vector<PairSum<T>> SumsOf(const std::vector<AscentPair>& pairs, const AscentState& state,
                               const TurntableAxis& axis, const AscentNoise& noise) {
  std::vector<PairSum<T>> sums(pairs.size());
  ParallelFor(static_cast<int64_t>(pairs.size()), 0, [&](int64_t p) {
    const auto at = static_cast<size_t>(p);
    sums[at] = SumOf<T>(pairs[at], state, axis, pairs[at].NoiseBy(noise));
  });
  return sums;
}

}  // namespace

AscentNoise AscentNoise::Widened(double width_px) const {
  return {std::max(object, width_px), std::max(background, width_px)};
}

AscentValue ValueOf(const AscentPair& pair, const AscentState& state, const TurntableAxis& axis,
                    double sigma_px) {
  return SumOf<double>(pair, state, axis, sigma_px);
}

std::vector<AscentValue> ValuesOf(const std::vector<AscentPair>& pairs, const AscentState& state,
                                  const TurntableAxis& axis, const AscentNoise& noise) {
  return SumsOf<double>(pairs, state, axis, noise);
}

std::vector<AscentStep> StepsOf(const std::vector<AscentPair>& pairs, const AscentState& state,
                                const TurntableAxis& axis, const AscentNoise& noise) {
  return SumsOf<Jet>(pairs, state, axis, noise);
}

}  // namespace s2gs
