#pragma once

#include <Eigen/Core>
#include <vector>

namespace s2gs {

/// Where the search for a width begins: no table is read as finely [rad].
inline constexpr double kLeastWidthRad = 1e-6;

/// A station's angles about what was expected of them: the scatter in the directions that what was fitted
/// leaves, and the variances there.
struct AngleScatter {
  Eigen::VectorXd deviations;  ///< along directions in which the errors are independent [rad].
  Eigen::VectorXd variances;   ///< of these errors [rad^2].
};

/// \param design      one row an angle, one column for each number that was fitted.
/// \param covariance  of the angles [rad^2]. \param deviations  of the angles from the fit [rad].
AngleScatter ScatterBeside(const Eigen::MatrixXd& design, const Eigen::MatrixXd& covariance,
                           const Eigen::VectorXd& deviations);

/// The largest standard deviation, common to all stations, that the scatter allows within two of its own,
/// beside the errors' variances (profile likelihood) [rad].
double LargestWidthRad(const std::vector<AngleScatter>& stations);

}  // namespace s2gs
