#pragma once

#include "sfm_split/split/motion_split.h"
#include "sfm_split/split/split_matching.h"

namespace s2gs {

/// The split of photos from stations. `split` comes with its stations, and leaves with labels,
/// representatives and pairs. Images with given labels keep them.
/// \param pictures  nullptr, or what tells the table from who walks by (PassersBy).
void SplitByStations(const ScanPictures* pictures, SplitMatching* matching, MotionSplit* split);

}  // namespace s2gs
