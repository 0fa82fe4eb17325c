#pragma once

#include <cstdint>
#include <vector>

#include "s2gs/backend/backend.h"
#include "s2gs/scene/training_scene.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

/// Which rotating Gaussians belong neither to the table's top nor to what stands on it: ground that training
/// lets turn where it is plain. The rotating part is fused into a coarse surface, in which FindTableTop looks
/// for the table and StandsOnTable says what lies beside it, as does what floats clear of all that the table
/// carries; a Gaussian goes with the surface nearest to it.
/// Empty where there is no axis, no table, or nothing beside it, and where photos were taken from several
/// stations, which tell where the ground is.
/// \param backend  with the model, which is left as it was.
std::vector<uint32_t> FindRotatingBesideTable(const TrainingScene& scene, Backend* backend,
                                              Reporter& reporter);

}  // namespace s2gs
