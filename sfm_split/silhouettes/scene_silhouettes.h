#pragma once

#include <map>
#include <vector>

#include "sfm_split/base/reporter.h"
#include "sfm_split/photo_tracks/track_places.h"
#include "sfm_split/silhouettes/silhouette_turns.h"
#include "sfm_split/turntable/align_scene.h"

namespace s2gs {

/// A station's views in the order of the table's angles, so that neighbours are neighbours.
std::vector<const View*> ViewsByAngle(const TurntableScene& scene, int station);

/// Asks the outlines in the photos how stations are turned against the reference's: by station. Stations with
/// too few photos, and photos that cannot be read or have another size than their station's, are left out.
/// Throws Interrupted when the reporter asks to stop, and what `read` throws.
std::map<int, SilhouetteTurn> AskSilhouettes(const ReadGreyPhoto& read, const TurntableScene& scene,
                                             const std::vector<int>& stations, Reporter& reporter);

}  // namespace s2gs
