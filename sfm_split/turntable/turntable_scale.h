#pragma once

#include <Eigen/Core>
#include <limits>
#include <optional>
#include <random>
#include <vector>

#include "sfm_split/turntable/turntable.h"
#include "sfm_split/turntable/turntable_axis.h"
#include "sfm_split/turntable/turntable_measurement.h"

namespace s2gs {

/// Scale and offsets of equation (3) of turntable.h. Standard deviations are infinite where the data leave
/// no redundancy.
struct TurntableOffsetFit {
  double scale = 1;                             ///< lambda.
  Eigen::Vector3d p = Eigen::Vector3d::Zero();  ///< background units; p . m = 0.
  Eigen::Vector3d a = Eigen::Vector3d::Zero();  ///< background units.
  double length = 1;                            ///< the camera's path about the object, background units.
  double sigma = std::numeric_limits<double>::infinity();  ///< of one residual coordinate, background units.
  double bound = 0;                                        ///< residuals above are outliers.
  double scale_sigma = std::numeric_limits<double>::infinity();
  double point_sigma = std::numeric_limits<double>::infinity();  ///< of a's worse direction across the axis.
  double centre_sigma = 0;                                       ///< of one station's centre.
  std::vector<double> singular_values;                           ///< with columns of unit length, descending.
  int num_inliers = 0;
};

/// The length of (3)'s residual, background units.
double TurntableOffsetResidual(const TurntableMeasurement& t, const TurntableOffsetFit& fit);

/// Random triples compete, reweighted least squares refine the best.
/// \param use          indices into `all`, of images that agree with the axis; at least one.
/// \param fixed_scale  lambda when it is known.
TurntableOffsetFit FitTurntableOffset(const std::vector<TurntableMeasurement>& all,
                                      const std::vector<int>& use, const TurntableAxisFit& axis,
                                      std::optional<double> fixed_scale, const TurntableOptions& options,
                                      std::mt19937* rng);

}  // namespace s2gs
