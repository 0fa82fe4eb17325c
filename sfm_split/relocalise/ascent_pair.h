#pragma once

#include <Eigen/Core>
#include <utility>
#include <vector>

#include "sfm_split/base/rigid3.h"
#include "sfm_split/scene/scene.h"

namespace s2gs {

/// Standard deviations of right matches' epipolar errors [px]. What shines or hardly has texture is found
/// worse than what stands about it: with one noise for both, many bad matches of the object would outvote the
/// background's good ones.
struct AscentNoise {
  double object = 0;
  double background = 0;

  /// No narrower than a width.
  AscentNoise Widened(double width_px) const;
};

/// A match in the undistorted pixels of both photos, from their principal points.
struct AscentPair {
  int station1 = 0;
  int station2 = 0;
  int camera1 = 0;
  int camera2 = 0;
  bool is_object = true;
  double angle1_rad = 0;
  double angle2_rad = 0;
  std::vector<std::pair<Eigen::Vector2d, Eigen::Vector2d>> matches;
  std::vector<double> chance;
  std::vector<double> weight;  ///< how much each counts; empty: once.

  double NoiseBy(const AscentNoise& noise) const { return is_object ? noise.object : noise.background; }
};

/// A station's camera, and the angle at which its photos begin.
struct AscentStation {
  Rigid3 cam_from_world;
  double turn_rad = 0;  ///< besides the table angles that its photos had.
};

/// What the likelihood of matches is climbed in.
struct AscentState {
  std::vector<AscentStation> stations;
  std::vector<double> log_focal;  ///< per camera.
};

/// Numbers of a station: six of its camera's pose (a small turn and the translation, both in the camera's
/// frame), and its turn.
inline constexpr int kAscentOfStation = 7;
/// Of a pair: two stations and two focal lengths.
inline constexpr int kAscentOfPair = 2 * kAscentOfStation + 2;

/// A pair's part of the logarithm of the likelihood over chance: each match counts by its probability to be
/// right.
struct AscentValue {
  double value = 0;
  double inliers = 0;
  double squares = 0;
};

/// And its part of a Gauss-Newton step.
struct AscentStep : AscentValue {
  Eigen::Matrix<double, kAscentOfPair, kAscentOfPair> normal =
      Eigen::Matrix<double, kAscentOfPair, kAscentOfPair>::Zero();
  Eigen::Matrix<double, kAscentOfPair, 1> right = Eigen::Matrix<double, kAscentOfPair, 1>::Zero();
};

/// \param sigma_px  standard deviation of a right match's error.
AscentValue ValueOf(const AscentPair& pair, const AscentState& state, const TurntableAxis& axis,
                    double sigma_px);
/// Of all pairs, on all cores.
std::vector<AscentValue> ValuesOf(const std::vector<AscentPair>& pairs, const AscentState& state,
                                  const TurntableAxis& axis, const AscentNoise& noise);
/// The same with their derivatives.
std::vector<AscentStep> StepsOf(const std::vector<AscentPair>& pairs, const AscentState& state,
                                const TurntableAxis& axis, const AscentNoise& noise);

}  // namespace s2gs
