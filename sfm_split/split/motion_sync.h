#pragma once

#include <vector>

#include "sfm_split/split/motion_split.h"

namespace s2gs {

/// Sorts the motions found in single pairs of images into two bodies.
///
/// Motions are the nodes of a graph. Two that share keypoints belong together, the more so the more they
/// share; two of one pair of images do not. The leading eigenvector of that graph (binary synchronisation),
/// and then single motions changing sides for as long as that makes more of the edges right, give every
/// motion a side. \param keypoints  per image; only their number matters. \param motions    the motions of
/// one pair of images stand one after another, the strongest first. \return per motion: 0 or 1. Side 0 is the
/// one with more matches.
std::vector<int> SortIntoBodies(const std::vector<Keypoints>& keypoints,
                                const std::vector<VerifiedPair>& motions);

}  // namespace s2gs
