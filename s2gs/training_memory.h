#pragma once

#include <cstdint>

#include "s2gs/backend/backend.h"
#include "s2gs/scene/training_size.h"
#include "s2gs/train_options.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

/// Memory that grows with the model.
struct MemoryNeed {
  int64_t fixed_bytes = 0;
  int64_t bytes_per_gaussian = 0;

  int64_t At(int64_t num_gaussians) const { return fixed_bytes + bytes_per_gaussian * num_gaussians; }
};

/// The most that a training holds at once, counted by its arrays, and the program itself. What a CUDA context
/// takes of both memories, some 500 MB, is not in it.
struct TrainingMemory {
  MemoryNeed host;
  MemoryNeed device;  ///< zero for the CPU's backend.
};

TrainingMemory PredictTrainingMemory(const TrainingSize& size, BackendKind kind);

/// What a training may take [bytes].
struct MemoryLimits {
  int64_t host = 0;
  int64_t device = 0;
};

/// States the peak of both memories and where it comes from. Where `options.max_gaussians` of them would not
/// fit, lowers that bound to what does and warns; throws UserError where not even the first Gaussians do,
/// with the photo size that would.
void FitTrainingMemory(const TrainingSize& size, BackendKind kind, const MemoryLimits& limits,
                       TrainOptions* options, Reporter& reporter);

}  // namespace s2gs
