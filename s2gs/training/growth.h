#pragma once

#include <cstdint>

#include "s2gs/train_options.h"
#include "s2gs/training/train_run.h"

namespace s2gs {

/// Clones and splits Gaussians, removes faint ones and makes all faint now and then, when the schedule says
/// so. Returns how many were removed because their parameters are no numbers. \param num_photos  that
/// training sees. \param before      progress before the last iteration; `now`: after it.
int64_t Grow(const TrainMoment& moment, int64_t num_photos, double before, double now, TrainRun* run);

}  // namespace s2gs
