#pragma once

#include "sfm_split/scene/scene.h"

namespace s2gs {

/// Numbers the stations that have views from 0 without gaps, in the order that they had, and counts them:
/// stations that were taken out, or placed anew under another number, leave gaps.
void NumberStations(TurntableScene* scene);

}  // namespace s2gs
