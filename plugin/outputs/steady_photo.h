#pragma once

#include <string>

#include "sfm_split/photo_tracks/track_places.h"
#include "sfm_split/turntable/steady_cameras.h"

namespace s2gs {

/// A photo as the camera of its station's first photo would have taken it; the same where its camera did not
/// move. What lies beyond the photo's border repeats it.
GreyPhoto SteadyPhoto(GreyPhoto photo, const std::string& name, const SteadyCameras& cameras);

}  // namespace s2gs
