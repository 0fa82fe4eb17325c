#pragma once

#include <set>

#include "sfm_split/turntable/align_scene.h"

namespace s2gs {

/// The stations between which the background tells how the table turned: the reference view's and those that
/// see background points of its own, by themselves or by others in between; none where it is alone.
///
/// \pre the scene has a reference view.
std::set<int> TiedStations(const AlignedScene& aligned);

}  // namespace s2gs
