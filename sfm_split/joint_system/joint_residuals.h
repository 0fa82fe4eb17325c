#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <optional>
#include <vector>

#include "sfm_split/joint_system/joint_problem.h"

namespace s2gs {

/// Residuals of active observations; observations behind the camera give the cost's constant error.
struct JointResiduals {
  double object_squares = 0;  ///< sum of |r|^2 [px^2].
  double background_squares = 0;
  int object = 0;  ///< number of observations.
  int background = 0;
  std::vector<double> coordinates;  ///< [px], two per observation.

  /// sqrt(mean |r|^2) [px].
  double Rms() const {
    return std::sqrt((object_squares + background_squares) / std::max(1, object + background));
  }
};

JointResiduals MeasureJointResiduals(const JointProblem& problem);

/// Of each observation of one body: how far its point's projection lies from it [px]. None of inactive ones
/// and of points behind the camera.
std::vector<std::optional<Eigen::Vector2d>> ReprojectionErrors(const JointProblem& problem, bool of_object);

/// Robust standard deviation of one coordinate, of the median of their lengths. \param parameters  fitted.
double RobustSigmaPx(std::vector<double> residuals, int parameters);

}  // namespace s2gs
