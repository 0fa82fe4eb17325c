#pragma once

#include "sfm_split/matching/pair_plan.h"
#include "sfm_split/split/motion_split.h"
#include "sfm_split/split/split_matching.h"

namespace s2gs {

/// The split of photos without stations: several motions are fitted to every pair and sorted into two bodies.
/// Where two bodies do not show convincingly, or `expect_one_body`, all photos become one body: object_pairs
/// has the strongest motion of every pair and static_pairs has none.
/// `split` comes with its stations, of which no two photos are matched, and, for one body, with the reason.
/// \param similarity  of all images, by a cheap matching.
void SplitWithoutStations(const SimilarityMatrix& similarity, bool expect_one_body, SplitMatching* matching,
                          MotionSplit* split);

}  // namespace s2gs
