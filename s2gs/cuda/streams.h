#pragma once

#include <cuda_runtime.h>

namespace s2gs::cuda {

/// Where a backend's work goes: to one stream, in order, but for what may go beside it while that waits for
/// memory.
class Streams {
 public:
  Streams();
  ~Streams();
  Streams(const Streams&) = delete;
  Streams& operator=(const Streams&) = delete;

  cudaStream_t main() const { return main_; }
  cudaStream_t side() const { return side_; }  ///< of the least priority.
  void Synchronize() const;                    ///< Reports no error: before the end.

  /// What `to` does from now on begins when `from` has done what it has.
  static void HandOver(cudaStream_t from, cudaEvent_t event, cudaStream_t to);

  cudaEvent_t step_begins = nullptr, colors_drawn = nullptr, maps_drawn = nullptr, maps_judged = nullptr,
              model_judged = nullptr;

 private:
  cudaStream_t main_ = nullptr, side_ = nullptr;
};

}  // namespace s2gs::cuda
