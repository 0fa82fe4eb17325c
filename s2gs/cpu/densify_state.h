#pragma once

#include "s2gs/backend/backend.h"

namespace s2gs {

/// Backend::Densify on the host's copy of everything, without finding neighbours anew.
DensifyResult DensifyState(const DensifyStep& step, TrainState* state);

}  // namespace s2gs
