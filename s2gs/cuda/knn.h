#pragma once

#include "s2gs/core/cuda.h"
#include "s2gs/cuda/device_data.h"

namespace s2gs::cuda {

/// At most so many neighbours.
constexpr int kMaxNeighbours = 64;

/// Exact nearest neighbours: points in Morton order, in boxes of 64; a point looks through its own box and
/// then through those boxes that come nearer than the worst neighbour it has.
class NeighbourFinder {
 public:
  explicit NeighbourFinder(DeviceMemoryCount* memory);

  /// \param centres     3 planes of `stride` floats; points that are not finite get neighbours of no meaning.
  /// \param neighbours  out: k planes of `count`. A point is never its own neighbour. k < count.
  void Find(const float* centres, size_t stride, int64_t count, int k, uint32_t* neighbours,
            cudaStream_t stream);

 private:
  DeviceBuffer<uint32_t> bounds_;  ///< of all points, as ordered integers.
  DeviceBuffer<uint64_t> codes_, sorted_codes_;
  DeviceBuffer<uint32_t> ids_, sorted_ids_;
  DeviceBuffer<float4> points_;  ///< in Morton order.
  DeviceBuffer<float4> boxes_;   ///< lower and upper corner of each.
  DeviceBuffer<char> scratch_;
};

}  // namespace s2gs::cuda
