#pragma once

#include <vector>

#include "sfm_split/adjust/track_triangulation.h"
#include "sfm_split/scene/scan_features.h"
#include "sfm_split/scene/scene.h"

namespace s2gs {

/// For each image of the features, how a scene has its camera: against the object, or against what stands
/// still. Not posed where the scene lacks it.
/// \param scene  must outlive the result.
std::vector<PosedImage> PosedImages(const ScanFeatures& features, const TurntableScene& scene,
                                    bool of_object);

}  // namespace s2gs
