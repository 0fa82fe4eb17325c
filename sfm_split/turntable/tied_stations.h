#pragma once

#include <set>
#include <vector>

#include "sfm_split/turntable/align_scene.h"

namespace s2gs {

/// The stations between which the background tells how the table turned: the reference view's and those that
/// see background points of its own, by themselves or by others in between; none where it is alone.
///
/// \pre the scene has a reference view.
std::set<int> TiedStations(const AlignedScene& aligned);

/// All stations in sets between which the background tells how the table turned, as in TiedStations; a
/// station that nothing ties is a set by itself. Between sets the angle is undetermined: a turn of the table
/// about its axis and one of the camera the other way look the same. By their first station, ascending.
std::vector<std::vector<int>> SetsOfTiedStations(const AlignedScene& aligned);

}  // namespace s2gs
