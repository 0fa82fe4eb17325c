#pragma once

#include <vector>

#include "sfm_split/joint_system/joint_priors.h"
#include "sfm_split/scene/scan_features.h"
#include "sfm_split/scene/scene.h"

namespace s2gs {

/// Moves each station's camera, as little as it takes, to where its rim is the picture of a circle about the
/// axis. Lenses, the axis and all angles stay. \param rims  by images of the features (FindRims).
void MoveToRims(const std::vector<RimPrior>& rims, const ScanFeatures& features, TurntableScene* scene);

/// How far rims lie off the nearest circles about the axis [px], in the mean of squares; of those whose
/// station has a place.
double RimErrorPx(const std::vector<RimPrior>& rims, const ScanFeatures& features,
                  const TurntableScene& scene);

}  // namespace s2gs
