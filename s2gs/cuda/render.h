#pragma once

#include "s2gs/cuda/device_data.h"

namespace s2gs::cuda {

/// Which maps are drawn.
struct RenderChannels {
  bool geometry = false;
  bool foreground = false;
};

struct RenderInput {
  ProjectedSplats splats;
  TileLists tiles;
  int width = 0, height = 0;
  float near_depth = 0;
};

void RenderForward(const RenderInput& input, RenderChannels channels, const Maps& maps, cudaStream_t stream);

/// Raises peak_weights[i] to the largest weight that splat i has in any pixel.
/// \param alpha  what all of them cover of each pixel; null: not asked for.
void RenderPeakWeights(const RenderInput& input, float* peak_weights, float* alpha, cudaStream_t stream);

/// Which of `count` weights are at least `min_weight`.
void MarkSeen(const float* peak_weights, int64_t count, float min_weight, uint8_t* is_seen,
              cudaStream_t stream);

/// Adds the loss by every splat, in PackedSplat's layout, to `d_splats` and `d_normal_z`.
void RenderBackward(const RenderInput& input, RenderChannels channels, const Maps& maps,
                    const MapGradients& gradients, const Vec3<float>& background, float* d_splats,
                    float* d_normal_z, cudaStream_t stream);

}  // namespace s2gs::cuda
