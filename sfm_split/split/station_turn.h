#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "sfm_split/split/motion_split.h"

namespace s2gs {

/// What turning the table looks like from one station. Between two photos that a turn by theta lies between,
/// points move as x2 = R (x1 - p) + p in the camera's frame, R the rotation by theta about `axis` and p the
/// axis' foot, whose distance is the unit of length: all epipolar geometries of the station are one family
/// with the angle as its only parameter.
struct StationTurn {
  double focal_px = 0;
  Eigen::Vector2d principal_point = Eigen::Vector2d::Zero();  ///< [px]
  Eigen::Vector3d axis = Eigen::Vector3d::Zero();             ///< unit.
  Eigen::Vector3d foot = Eigen::Vector3d::Zero();             ///< unit, at right angles to the axis.
  double step_rad = 0;                                        ///< between photos that follow each other.
  bool is_full_turn = false;  ///< the photos' matches close the circle: focal length and step are known.
  double inlier_share = 0;    ///< of the matches that it was fitted to.

  /// x2ᵀ F x1 = 0 in pixels.
  Eigen::Matrix3d Fundamental(double theta_rad) const;
};

/// Matches of a station's photos `steps` places apart (negative: backwards).
struct TurnMatches {
  int steps = 0;
  std::vector<Eigen::Vector2f> xy1;  ///< [px]
  std::vector<Eigen::Vector2f> xy2;  ///< [px]
};

/// Fits the family to photos few steps apart, taking the steps to be equal; robust against outliers.
/// Photos a few steps apart hardly tell a long focal length and large steps from a short one and small steps.
/// Where matches between the station's last photos and its first ones fit a full turn of `num_photos` equal
/// steps, the step is that turn's.
/// Nothing when fewer than `min_inlier_share` of the matches follow any: the steps are too unequal, or the
/// photos are not in the order of capture.
/// \param pairs         of photos few steps apart, also across the end of a full turn.
/// \param size          of the photos [px].
/// \param max_error_px  largest Sampson error of an inlier [px].
/// \param focal_px      where it is known.
std::optional<StationTurn> FitStationTurn(const std::vector<TurnMatches>& pairs, int num_photos,
                                          const Eigen::Vector2i& size, double max_error_px,
                                          double min_inlier_share,
                                          std::optional<double> focal_px = std::nullopt);

/// Whether the matches fit the angle that their number of steps makes, or, as on an object that looks the
/// same from several sides, fit another angle much better.
bool FitsItsAngle(const StationTurn& turn, const TurnMatches& pair, double max_error_px);

}  // namespace s2gs
