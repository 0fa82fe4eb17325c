#pragma once

#include "sfm_split/single_axis/single_axis_rays.h"

namespace s2gs {

/// A turn of the table between two images, and how many of their matches agree with it.
struct TurnVote {
  double angle = 0;  ///< [rad]
  double score = 0;  ///< sum of 1 - (error / bound)^2 over agreeing matches.
};

/// The turn about `axis` that most matches of the pair agree with by Sampson's error and both points in
/// front. \param max_proposals  about how many of the matches' own angles are tried.
TurnVote BestTurn(const AxisRays& rays, const RayPair& pair, const TurntableAxis& axis, double bound_px,
                  int max_proposals);

}  // namespace s2gs
