#pragma once

#include <vector>

#include "s2gs/backend/backend.h"
#include "s2gs/scene/training_scene.h"

namespace s2gs {

/// The training photos (without those held out) at 1 / 2^level of their size.
/// \param min_size  a photo's longer side gets no smaller than this [px].
std::vector<TrainingPhoto> PhotosAtLevel(const TrainingScene& scene, int level, int min_size);

}  // namespace s2gs
