#pragma once

#include <Eigen/Core>
#include <utility>
#include <vector>

#include "sfm_split/base/rigid3.h"

namespace s2gs {

/// A pose's deviation from the nearest pure turn about an axis.
struct WobbleOfPose {
  Eigen::Vector3d tilt_rad = Eigen::Vector3d::Zero();  ///< rotation vector, across the axis.
  Eigen::Vector3d shift = Eigen::Vector3d::Zero();     ///< of the object's point on the axis, in the world.
};
WobbleOfPose DeviationFromTurn(const Eigen::Vector3d& axis_direction, const Eigen::Vector3d& axis_point,
                               const Rigid3& world_from_object);

/// Two unit vectors across an axis, at a right angle to each other.
std::pair<Eigen::Vector3d, Eigen::Vector3d> AcrossAxis(const Eigen::Vector3d& axis_direction);

/// How a plate tilts and lifts what stands on it as its bearing goes round, once and twice a turn: a smooth
/// function of the table's angle.
struct WobbleHarmonics {
  static constexpr int kTerms = 5;  ///< 1; cosine and sine of the angle; of twice the angle.
  static constexpr int kParts = 5;  ///< as Parts lists them.
  static constexpr int kCoefficients = kParts * kTerms;  ///< of one station.
  using Terms = Eigen::Matrix<double, kTerms, 1>;
  /// Tilt about the two vectors of AcrossAxis [rad], shift of the axis' point in x, y and z [world units].
  using Parts = Eigen::Matrix<double, kParts, 1>;

  std::vector<int> images;  ///< of the problem, that it is the wobble of.
  Eigen::Matrix<double, kParts, kTerms, Eigen::RowMajor> coefficients;

  WobbleHarmonics() { coefficients.setZero(); }
  static Terms TermsAt(double angle_rad);
  Parts At(double angle_rad) const { return coefficients * TermsAt(angle_rad); }
};

}  // namespace s2gs
