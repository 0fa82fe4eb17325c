#pragma once

#include "s2gs/backend/backend.h"
#include "s2gs/cuda/device_data.h"

namespace s2gs::cuda {

/// A training photo on the GPU.
struct DevicePhoto {
  const uint8_t* rgb = nullptr;   ///< interleaved.
  const uint8_t* mask = nullptr;  ///< null: none.
  int width = 0, height = 0;
};

struct ImageLossInput {
  DevicePhoto photo;
  Vec3<float> background;
  bool cut_out_mask = false;
  const uint8_t* is_listed = nullptr;  ///< by tile: in the others the photo counts as met. Null: none is met.
  LossWeights weights;
  float fx = 0, fy = 0, cx = 0, cy = 0;
  const StepReport* report = nullptr;  ///< sums are left alone when it says overflow.
};

/// L1 and D-SSIM. Writes d_maps.color. \param partials  9 planes of scratch.
void ColorLoss(const ImageLossInput& input, const Maps& maps, const MapGradients& d_maps, float* partials,
               LossSums* sums, cudaStream_t stream);

/// (12), the mask's term, normal consistency and distortion. Writes the gradients of the channels that are
/// on.
void MapLoss(const ImageLossInput& input, bool geometry, bool foreground, const Maps& maps,
             const MapGradients& d_maps, LossSums* sums, cudaStream_t stream);

struct ModelLossInput {
  const float* foreground_logits = nullptr;
  int count = 0;
  const uint32_t* neighbours = nullptr;  ///< num_neighbours planes of `count`.
  int num_neighbours = 0;
  float local_consistency = 0, entropy_3d = 0;  ///< weights.
  const StepReport* report = nullptr;
};

/// (10) and (11). Writes the loss by the logits to d_logits.
void ModelLoss(const ModelLossInput& input, float* d_logits, LossSums* sums, cudaStream_t stream);

}  // namespace s2gs::cuda
