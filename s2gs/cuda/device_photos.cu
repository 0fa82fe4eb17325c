#include "s2gs/cuda/device_photos.h"
#include "s2gs/cuda/model_transfer.h"

namespace s2gs::cuda {

void DevicePhotos::Set(const std::vector<TrainingPhoto>& photos, cudaStream_t stream) {
  photos_.clear();
  photos_.reserve(photos.size());
  size_t num_bytes = 0;
  for (const TrainingPhoto& photo : photos) num_bytes += photo.image.pixels.size() + photo.mask.size();
  bytes_.Reserve(num_bytes);
  uint8_t* next = bytes_.get();
  const auto upload = [&](const std::vector<uint8_t>& values) -> const uint8_t* {
    if (values.empty()) return nullptr;
    uint8_t* target = next;
    UploadArray(values, target, "photos", stream);
    next += values.size();
    return target;
  };
  for (const TrainingPhoto& photo : photos) {
    S2GS_INVARIANT(photo.image.channels == 3 && photo.image.width == photo.view.width &&
                   photo.image.height == photo.view.height);
    const uint8_t* rgb = upload(photo.image.pixels);
    const uint8_t* mask = upload(photo.mask);
    photos_.push_back({photo.view, {rgb, mask, photo.view.width, photo.view.height}});
  }
  CheckCuda(cudaStreamSynchronize(stream), "photos");
}

}  // namespace s2gs::cuda
