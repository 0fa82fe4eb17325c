#pragma once

#include <cstdint>
#include <vector>

#include "s2gs/backend/backend.h"
#include "s2gs/core/cuda.h"
#include "s2gs/cuda/densify.h"
#include "s2gs/cuda/device_data.h"
#include "s2gs/cuda/knn.h"

namespace s2gs::cuda {

/// The training state on the GPU: parameters and both moments, the sums that growth asks for, and neighbours.
/// All work goes to one stream. What steps have left of the colours (ColorLog) is to be written back before
/// anything here looks at the model.
class DeviceModel {
 public:
  DeviceModel(DeviceMemoryCount* memory, cudaStream_t stream);

  int64_t count() const { return count_; }
  size_t stride() const { return stride_; }  ///< of the planes; rows of arrays besides it are as many.
  int sh_degree() const { return sh_degree_; }
  void set_sh_degree(int degree) { sh_degree_ = degree; }
  Planes parameters() const { return {model_.get(), stride_}; }
  Planes first_moments() const { return {model_.get() + kNumPlanes * stride_, stride_}; }
  Planes second_moments() const { return {model_.get() + 2 * kNumPlanes * stride_, stride_}; }
  float* gradient_sum() const { return gradient_sum_.get(); }
  float* view_count() const { return view_count_.get(); }
  const uint32_t* neighbours() const { return neighbours_.get(); }  ///< num_neighbours() planes of count().
  int num_neighbours() const { return num_neighbours_; }

  /// As Backend's functions of the same names. They wait for the GPU.
  void SetState(const TrainState& state);
  TrainState GetState() const;
  Gaussians GetGaussians() const { return Download(parameters()); }
  Placement GetPlacement() const;
  void Keep(const std::vector<uint32_t>& indices);
  DensifyResult Densify(const DensifyStep& step);
  void RefreshNeighbours(int k);

 private:
  void Reserve(int64_t count);
  void ReserveStatistics();
  void ClearStatistics();
  std::vector<float> Chosen(const float* data, const std::vector<uint32_t>& indices) const;
  void UploadSums(const std::vector<float>& values, float* target) const;
  Gaussians Download(const Planes& planes) const;
  void Wait() const { CheckCuda(cudaStreamSynchronize(stream_), "computation"); }

  DeviceMemoryCount* memory_;
  cudaStream_t stream_;
  // Parameters, first and second moments, each kNumPlanes planes of stride_.
  DeviceBuffer<float> model_;
  DeviceBuffer<float> spare_;
  size_t stride_ = 0;
  int64_t count_ = 0;
  int sh_degree_ = 0;
  DeviceBuffer<float> gradient_sum_, view_count_;
  DeviceBuffer<uint32_t> neighbours_;
  int num_neighbours_ = 0;
  DensifyPlan densify_;
  NeighbourFinder finder_;
};

}  // namespace s2gs::cuda
