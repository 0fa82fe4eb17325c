#pragma once

#include <vector>

#include "sfm_split/single_axis/single_axis_rays.h"
#include "sfm_split/single_axis/turn_vote.h"

namespace s2gs {

/// The table's angle at each image.
struct ImageTurns {
  std::vector<double> angles;   ///< [rad] about the axis, up to a common one.
  std::vector<char> connected;  ///< 1: pairs tie the image to the others that are.
};

/// Angles of images from angles of pairs: a maximum spanning tree by votes, then reweighted least squares on
/// the circle over all pairs. \param votes  one per pair of `rays`.
ImageTurns SynchronizeTurns(const AxisRays& rays, const std::vector<TurnVote>& votes);

/// 1 for the images of the largest set that agreeing matches tie together.
/// \param inliers_of_pair  per pair of the input and match: 1 where it agrees.
/// \param among            one per image: 0 for those that start no set.
std::vector<char> LargestConnected(const AxisRays& rays,
                                   const std::vector<std::vector<char>>& inliers_of_pair,
                                   const std::vector<char>& among);

}  // namespace s2gs
