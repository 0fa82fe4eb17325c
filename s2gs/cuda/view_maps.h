#pragma once

#include "s2gs/core/cuda.h"
#include "s2gs/cuda/device_data.h"
#include "s2gs/cuda/render.h"

namespace s2gs::cuda {

/// Memory for the maps of one view and for the loss's gradients by them. It grows and is used again.
class ViewMaps {
 public:
  explicit ViewMaps(DeviceMemoryCount* memory);

  Maps Reserve(int width, int height, RenderChannels channels);
  MapGradients ReserveGradients(int width, int height, RenderChannels channels);
  /// 9 planes of scratch for ColorLoss, of the size of the last gradients.
  float* partials() const { return partials_.get(); }

 private:
  DeviceBuffer<float> color_, foreground_, geometry_;
  DeviceBuffer<float> partials_, d_color_, d_foreground_, d_geometry_;
};

}  // namespace s2gs::cuda
