#pragma once

#include <vector>

#include "plugin/outputs/dense_views.h"

namespace s2gs {

/// By how much the grey values of each photo are brighter than what its camera's photos show of the
/// background in the middle (LogExposureGains); 1 where that does not tell. \param stations  of the photos;
/// -1: of none.
std::vector<double> GreyGains(const DensePhotos& photos, const std::vector<int>& stations, int num_threads);

}  // namespace s2gs
