#pragma once

#include "s2gs/backend/backend.h"
#include "s2gs/cuda/device_data.h"
#include "s2gs/kernel/surfel.h"

namespace s2gs::cuda {

struct ProjectOptions {
  SplatCamera<float> camera;
  ForegroundRule rule = ForegroundRule::kSoft;
  DrawnSelection<float> selection;
  bool hard_map = false;  ///< the map of p shows P in its place.
  int sh_degree = 0;
};

/// Parameters -> splats of one view but for their colours (colors.h), with the number of tiles that each
/// reaches.
void Project(const Planes& parameters, int64_t count, const ProjectOptions& options,
             const ProjectedSplats& splats, cudaStream_t stream);

}  // namespace s2gs::cuda
