#pragma once

#include <Eigen/Core>
#include <limits>
#include <random>
#include <vector>

#include "sfm_split/turntable/turntable.h"
#include "sfm_split/turntable/turntable_measurement.h"

namespace s2gs {

/// The table's axis, n in the background's frame and m in the object's: equation (2) of turntable.h.
struct TurntableAxisFit {
  Eigen::Vector3d n = Eigen::Vector3d::UnitZ();
  Eigen::Vector3d m = Eigen::Vector3d::UnitZ();
  double sigma = 0;  ///< of one residual coordinate [rad], from the inliers; infinite without redundancy.
  double bound = 0;  ///< residuals above are outliers [rad].
  double axis_sigma = std::numeric_limits<double>::infinity();  ///< of n's worse direction [rad].
  double spread = 0;                                            ///< sqrt(1 - q^2).
  int num_inliers = 0;
};

/// The angle between A_t m and n [rad].
double TurntableAxisResidual(const TurntableMeasurement& t, const Eigen::Vector3d& n,
                             const Eigen::Vector3d& m);

/// Random pairs compete, reweighted least squares refine the best. Without any turn between the images the
/// fit is as constructed, with no inliers. \param use  indices into `all`.
TurntableAxisFit FitTurntableAxis(const std::vector<TurntableMeasurement>& all, const std::vector<int>& use,
                                  const TurntableOptions& options, std::mt19937* rng);

}  // namespace s2gs
