#pragma once

#include <array>
#include <cstdint>

#include "s2gs/core/cuda.h"
#include "s2gs/cuda/bin.h"

namespace s2gs::cuda {

/// How many pairs of a splat and a tile a step may sort. A view's count is not known when its sort is
/// launched, so there is room for the recent steps' peak and a margin; each step's count comes back while
/// later steps run. The host may be up to kStepsAhead steps ahead of the GPU.
class StepReports {
 public:
  explicit StepReports(DeviceMemoryCount* memory);
  ~StepReports();
  StepReports(const StepReports&) = delete;
  StepReports& operator=(const StepReports&) = delete;

  /// The step at hand's, on the GPU.
  StepReport* report() const { return report_.get(); }
  /// Pairs that a step sorts; 0: not known yet.
  int64_t room() const { return room_; }
  /// Pairs that there is memory for, room() or more: what is sized by it grows as seldom.
  int64_t reserved_room() const { return reserved_room_; }

  /// Pairs of the step at hand. Waits for the GPU. Throws UserError when they cannot be counted in 63 bits.
  int64_t Count(cudaStream_t stream) const;
  /// Room for at least so many pairs, with a margin over the recent peak.
  void MakeRoom(int64_t count, TileSorter* sorter);
  /// The model has grown by `ratio`, and with it presumably the counts to come.
  void ExpectGrowth(double ratio, TileSorter* sorter);
  /// To be called when views or model are others: counts on their way do not matter any more.
  void Forget();

  /// Sends the step's count to the host, to be read when it has arrived. There is a free slot after Read.
  void Send(cudaStream_t stream);
  /// Takes in the counts that have arrived; waits for the oldest when the host is too far ahead. May enlarge
  /// the buffers of the tile lists, so only where no list is in use.
  void Read(TileSorter* sorter);

 private:
  static constexpr int kStepsAhead = 8;

  DeviceBuffer<StepReport> report_;
  StepReport* host_reports_ = nullptr;
  std::array<cudaEvent_t, kStepsAhead> events_{};
  int64_t num_sent_ = 0, num_read_ = 0;
  double peak_ = 0;
  int64_t room_ = 0;
  int64_t reserved_room_ = 0;
};

}  // namespace s2gs::cuda
