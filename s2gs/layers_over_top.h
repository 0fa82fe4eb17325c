#pragma once

#include <cstdint>
#include <vector>

#include "s2gs/backend/backend.h"
#include "s2gs/photo_table.h"
#include "s2gs/plain_top.h"

namespace s2gs {

/// Depths of the rotating part alone as each photo of the stations sees it, by photo and pixel; 0 where it is
/// not opaque. \param backend  with the model, which is left as it was.
std::vector<std::vector<float>> RotatingDepths(const std::vector<StationPhotos>& stations, Backend* backend);

/// The rotating Gaussians over the top, higher than a pixel of the photos, that photos refute: the top in its
/// own light is seen through them, more often than chance and than something else that nothing before them
/// explains. In a shadow a thing of the same colour would look the same, so that shadows say nothing.
/// \param stations  Learn's. \param depths  RotatingDepths'.
std::vector<uint32_t> FindLayersOverTop(const PlainTop& top, const std::vector<StationPhotos>& stations,
                                        const std::vector<std::vector<float>>& depths,
                                        const Placement& gaussians);

}  // namespace s2gs
