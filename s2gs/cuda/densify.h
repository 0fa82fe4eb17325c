#pragma once

#include "s2gs/backend/backend.h"
#include "s2gs/core/cuda.h"
#include "s2gs/cuda/device_data.h"

namespace s2gs::cuda {

/// Parameters and both moments, 3 kNumPlanes planes, of the Gaussians of the given indices.
/// \param sources  `count` indices into `from`.
/// \param births   null: all keep their moments; otherwise how each came about (0: it is the old one).
void GatherModel(const uint32_t* sources, const uint8_t* births, int64_t count, const Planes& from,
                 const Planes& to, cudaStream_t stream);

/// Where each Gaussian of the model after a densification comes from.
class DensifyPlan {
 public:
  explicit DensifyPlan(DeviceMemoryCount* memory);

  /// Decides for each Gaussian. Waits for the GPU.
  DensifyResult Make(const Planes& parameters, int64_t count, const float* gradient_sum,
                     const float* view_count, const DensifyStep& step, cudaStream_t stream);

  /// Parameters and moments of the new model; new Gaussians begin without moments.
  void Gather(const Planes& from, const Planes& to, cudaStream_t stream) const;
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
