#pragma once

#include <random>

#include "sfm_split/base/reporter.h"
#include "sfm_split/single_axis/single_axis_rays.h"

namespace s2gs {

struct AxisSearch {
  TurntableAxis axis;
  double margin = 0;  ///< as SingleAxisSolution::margin; infinite without another axis.
};

/// The axis that the pairs' votes together support best: a coarse grid of directions and offsets, its best
/// refined. Throws Interrupted when the reporter asks to stop. \param bound_px  error of an inlier.
AxisSearch SearchAxis(const AxisRays& rays, const SingleAxisOptions& options, double bound_px,
                      std::mt19937* rng, Reporter& reporter);

}  // namespace s2gs
