#pragma once

#include "s2gs/backend/backend.h"
#include "s2gs/cuda/device_data.h"
#include "s2gs/cuda/project.h"
#include "s2gs/kernel/adam.h"

namespace s2gs::cuda {

struct OptimiseInput {
  Planes parameters, first_moments, second_moments;
  int count = 0;
  ProjectOptions view;  ///< as in the forward pass.
  ProjectedSplats splats;
  float* d_splats = nullptr;  ///< read, and set to zero for the next step.
  float* d_normal_z = nullptr;
  const float* d_logits = nullptr;  ///< loss of the model by the foreground logits; null: none.
  const uint8_t* color_traits = nullptr;
  Planes scratch;                  ///< ScratchPlane's: kColorByDirection in, a slot of the colours' log out.
  int color_slot = 0;              ///< that slot.
  uint32_t* is_skipped = nullptr;  ///< by slot; out: 1 when nothing was changed.
  bool has_geometry = false;
  bool learns_foreground = false;
  bool only_drawn = false;  ///< the others stay as they are, with their moments.
  AdamStep<float> adam;
  LearningRates rates;
  float* gradient_sum = nullptr;  ///< null: no statistics.
  float* view_count = nullptr;
  const StepReport* report = nullptr;
  LossSums* sums = nullptr;
};

/// Gradient by the splats -> gradient by the parameters -> Adam, of all but the colours' bands 1 to 3
/// (ColorUpdate). Changes nothing when the report says overflow.
void Optimise(const OptimiseInput& input, cudaStream_t stream);

}  // namespace s2gs::cuda
