#pragma once

#include <vector>

#include "sfm_split/split/motion_split.h"
#include "sfm_split/split/split_matching.h"

namespace s2gs {

/// Takes out pairs of photos of one station that show a wrong angle. An object that looks the same from
/// several sides matches itself at wrong angles, and consistently so: third images confirm it. What photos a
/// few steps apart say about the station (FitStationTurn) tells the angles apart. \param order  per station:
/// its photos as the table turned.
void RemoveFoldedPairs(const SplitMatching& matching, const Stations& stations,
                       const std::vector<std::vector<int>>& order, std::vector<VerifiedPair>* object_pairs);

}  // namespace s2gs
