#pragma once

#include "sfm_split/split/motion_split.h"
#include "sfm_split/split/split_matching.h"

namespace s2gs {

/// The split of photos from stations. `split` comes with its stations, and leaves with labels,
/// representatives and pairs. Images with given labels keep them.
void SplitByStations(SplitMatching* matching, MotionSplit* split);

}  // namespace s2gs
