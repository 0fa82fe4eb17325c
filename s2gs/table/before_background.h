#pragma once

#include <cstdint>
#include <vector>

#include "s2gs/backend/backend.h"
#include "s2gs/image/image_error.h"
#include "s2gs/table/photo_table.h"

namespace s2gs {

/// Rotating Gaussians at whose places photos show the background. What it looks like at a pixel the photos of
/// the station tell in which the pixel is outside of the rotating part's mask, and where there are none what
/// is about it in three directions of eight, if that looks alike (a plain wall) and what turns is beyond what
/// photos differ by there at least half as often as elsewhere: what turns differs from that in most photos
/// (as often as the rotating part does at large), what next to it was trained to turn, as plain ground and
/// shadows are, in none but by chance. Needs no table's rim. In ascending order; none where photos do not
/// tell the rotating part from the background. \param masks  of what rotates, of the stations' photos.
std::vector<uint32_t> FindShowingBackground(const std::vector<StationPhotos>& stations,
                                            const std::vector<std::vector<PixelMask>>& masks,
                                            const Placement& gaussians);

}  // namespace s2gs
