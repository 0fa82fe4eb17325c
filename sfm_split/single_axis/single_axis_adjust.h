#pragma once

#include <Eigen/Core>
#include <vector>

#include "sfm_split/base/reporter.h"
#include "sfm_split/single_axis/image_turns.h"
#include "sfm_split/single_axis/single_axis_rays.h"

namespace s2gs {

/// Normal equations of the axis and the images' angles.
struct AxisNormal {
  Eigen::MatrixXd matrix;   ///< empty when there was nothing to adjust or a step was not finite.
  std::vector<int> column;  ///< of each image's angle; -1: it has none.
};

/// Gauss-Newton over the axis and the angles of connected images, on all matches between them.
/// \param reference  the image whose angle stays; -1: there is nothing to adjust.
/// \param scale_px   of the robust loss.
/// Throws Interrupted when the reporter asks to stop.
AxisNormal AdjustAxisAndTurns(const AxisRays& rays, int reference, double scale_px, int iterations,
                              Reporter& reporter, TurntableAxis* axis, ImageTurns* turns);

/// Standard deviations.
struct AxisSigmas {
  double direction_deg = 0;         ///< of the axis, the worse direction.
  double point = 0;                 ///< across the axis, the worse direction.
  std::vector<double> of_turn_deg;  ///< per image; 0 where it has no column.
};

/// \param sigma_px  of one match's error.
AxisSigmas SigmasOf(const AxisRays& rays, const AxisNormal& normal, double sigma_px);

}  // namespace s2gs
