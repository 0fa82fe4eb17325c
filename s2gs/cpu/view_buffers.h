#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>

#include "s2gs/cpu/tile_kernel.h"
#include "sfm_split/base/thread_pool.h"

namespace s2gs {

/// The maps of one view and the loss by them, padded to whole tiles with 8 more values before and after each
/// row. What lies outside of the image stays 0 in the gradients and in `image` and `photo`. Memory is kept
/// between views; what no view has asked for takes none.
class ViewBuffers {
 public:
  /// All zeros when the size changes or a channel comes into use; else what was there before stays. Throws
  /// Interrupted as ThreadPool::For does; what was to become zero then does so the next time.
  void Prepare(int width, int height, bool geometry, bool foreground, bool training, ThreadPool* threads);

  const ViewPlanes& planes() const { return planes_; }
  const ViewGradients& gradients() const { return gradients_; }
  size_t stride() const { return planes_.stride; }
  /// Of training alone.
  float* image(int channel) { return training_.Plane(kImage + channel); }  ///< colour with its background.
  float* photo(int channel) { return training_.Plane(kPhoto + channel); }
  float* scratch(int i) { return training_.Plane(kScratch + i); }

 private:
  // Planes of what comes into use together, in one allocation each: one after the other, so that the same
  // pixel of two planes seldom lies in the same set of a cache.
  enum Drawn : int { kTransmittance = 0, kColor = 1, kForeground = 4, kNumDrawn = 5 };
  enum Geometry : int { kNormal = 0, kDepth = 3, kMedian, kDistortion, kM1, kM2, kWeight, kNumGeometry };
  enum Training : int {
    kImage = 0,
    kPhoto = 3,
    kScratch = 6,  // 7 for each channel.
    kByColor = 27,
    kByAlpha = 30,
    kByForeground = 31,
    kNumTraining = 32,
  };
  enum TrainingGeometry : int { kByNormal = 0, kByDepth = 3, kByDistortion, kNumTrainingGeometry };

  static constexpr size_t kMargin = 8;

  struct Block {
    std::unique_ptr<float[]> values;
    size_t capacity = 0;      // floats that `values` has room for
    size_t plane_floats = 0;  // 0: not in use

    float* Plane(int index) const { return values.get() + plane_floats * index + kMargin; }
    void Use(int num_planes, size_t plane_floats, ThreadPool* threads);
  };

  void SetPlanes(bool geometry, bool foreground, bool training);

  int width_ = 0;
  int height_ = 0;
  Block drawn_, geometry_, training_, training_geometry_;
  std::unique_ptr<int32_t[]> stop_;
  size_t stop_capacity_ = 0;
  ViewPlanes planes_;
  ViewGradients gradients_;
};

}  // namespace s2gs
