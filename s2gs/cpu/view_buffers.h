#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "s2gs/cpu/tile_kernel.h"

namespace s2gs {

/// The maps of one view and the loss by them, padded to whole tiles with 8 more values before and after each
/// row. What lies outside of the image stays 0 in the gradients and in `image` and `photo`.
class ViewBuffers {
 public:
  /// All zeros when the size changes or a channel comes into use; else what was there before stays.
  void Prepare(int width, int height, bool geometry, bool foreground, bool training);

  const ViewPlanes& planes() const { return planes_; }
  const ViewGradients& gradients() const { return gradients_; }
  size_t stride() const { return planes_.stride; }
  float* image(int channel) { return Plane(kImage + channel); }  ///< colour with its background.
  float* photo(int channel) { return Plane(kPhoto + channel); }
  float* scratch(int i) { return Plane(kScratch + i); }

 private:
  // Planes in one allocation; those of geometry last.
  enum : int {
    kTransmittance = 0,
    kColor = 1,
    kForeground = 4,
    kImage = 5,
    kPhoto = 8,
    kScratch = 11,  // 7 for each channel.
    kByColor = 32,
    kByAlpha = 35,
    kByForeground = 36,
    kNormal = 37,
    kDepth = 40,
    kMedian = 41,
    kDistortion = 42,
    kM1 = 43,
    kM2 = 44,
    kByNormal = 45,
    kByDepth = 48,
    kByDistortion = 49,
    kWeight = 50,
    kNumPlanes = 51,
  };

  float* Plane(int index) { return values_.data() + plane_floats_ * index + kMargin; }

  static constexpr size_t kMargin = 8;
  int width_ = 0;
  int height_ = 0;
  size_t plane_floats_ = 0;
  std::vector<float> values_;
  std::vector<int32_t> stop_;
  ViewPlanes planes_;
  ViewGradients gradients_;
};

}  // namespace s2gs
