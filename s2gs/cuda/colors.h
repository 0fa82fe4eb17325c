#pragma once

#include "s2gs/backend/backend.h"
#include "s2gs/cuda/device_data.h"
#include "s2gs/cuda/project.h"
#include "s2gs/kernel/adam.h"

namespace s2gs::cuda {

/// What a step leaves to be learnt of the colours' bands 1 to 3: nothing but colours needs it before the next
/// view is drawn.
struct ColorUpdate {
  int sh_degree = 0;  ///< of the step.
  AdamStep<float> adam;
  float rate = 0;
  const uint32_t* tile_counts = nullptr;  ///< those of 0 stay as they are. Null: none does.
  const uint32_t* is_skipped = nullptr;   ///< 1: the step changes nothing.
};

struct ColorInput {
  Planes parameters, first_moments, second_moments;
  Planes scratch;  ///< ScratchPlane's: gradients by the last view's colours in, kColorByDirection out.
  int64_t count = 0;
};

/// The update, if there is one, and then opacities and colours in `splats` and how the colours change with
/// the view direction.
void DrawColors(const ColorInput& input, const ColorUpdate* update, const ProjectOptions& view,
                PackedSplat* splats, cudaStream_t stream);

/// The update alone.
void LearnColors(const ColorInput& input, const ColorUpdate& update, cudaStream_t stream);

}  // namespace s2gs::cuda
