#pragma once

#include "s2gs/backend.h"
#include "s2gs/core/cuda.h"
#include "s2gs/cuda/device_data.h"

namespace s2gs::cuda {

/// Where each Gaussian of the model after a densification comes from.
class DensifyPlan {
 public:
  explicit DensifyPlan(DeviceMemoryCount* memory);

  /// Decides for each Gaussian. Waits for the GPU.
  DensifyResult Make(const Planes& parameters, int64_t count, const float* gradient_sum,
                     const float* view_count, const DensifyStep& step, cudaStream_t stream);

  /// One plane of parameters (or moments, which new Gaussians begin without) of the new model.
  void Gather(const float* source, float* target, bool is_moment, cudaStream_t stream) const;
  /// Centres and scales of the children of splits, into planes that Gather has filled.
  void PlaceChildren(const Planes& old_parameters, const Planes& new_parameters, const DensifyStep& step,
                     cudaStream_t stream) const;

 private:
  DeviceBuffer<uint8_t> actions_;
  DeviceBuffer<uint32_t> keys_, sorted_keys_, ids_, sorted_ids_;
  DeviceBuffer<uint32_t> kept_, added_;      ///< flags, then places.
  DeviceBuffer<uint32_t> sources_;           ///< old index of each new Gaussian.
  DeviceBuffer<uint8_t> births_;             ///< Birth of each new Gaussian.
  DeviceBuffer<unsigned long long> totals_;  ///< of each action.
  DeviceBuffer<char> scratch_;
  int64_t new_count_ = 0;
};

}  // namespace s2gs::cuda
