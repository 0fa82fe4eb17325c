#pragma once

#include <vector>

#include "s2gs/backend/backend.h"
#include "s2gs/core/cuda.h"
#include "s2gs/cuda/losses.h"

namespace s2gs::cuda {

/// The training photos on the GPU, one after the other in one array.
class DevicePhotos {
 public:
  struct Photo {
    PinholeView view;
    DevicePhoto device;
  };

  explicit DevicePhotos(DeviceMemoryCount* memory) : bytes_(memory) {}

  /// Replaces all of them. Waits for the GPU.
  void Set(const std::vector<TrainingPhoto>& photos, cudaStream_t stream);

  size_t size() const { return photos_.size(); }
  const Photo& operator[](size_t i) const { return photos_[i]; }

 private:
  std::vector<Photo> photos_;
  DeviceBuffer<uint8_t> bytes_;
};

}  // namespace s2gs::cuda
