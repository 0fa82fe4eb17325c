#include "s2gs/cpu/view_buffers.h"

#include <algorithm>

namespace s2gs {
namespace {

constexpr int64_t kZeroedAtOnce = 1 << 18;  // floats, 1 MiB: asked often, begun seldom. A judgement.

}  // namespace

void ViewBuffers::Block::Use(int num_planes, size_t floats, ThreadPool* threads) {
  if (plane_floats == floats) return;
  plane_floats = 0;
  const size_t needed = floats * num_planes;
  if (capacity < needed) {
    values.reset();
    capacity = 0;
    values.reset(new float[needed]);  // not value-initialised: see below
    capacity = needed;
  }
  // A large view's planes are gigabytes, which the system hands out page by page as they are written.
  threads->For(static_cast<int64_t>(needed), kZeroedAtOnce, [this](int64_t begin, int64_t end) {
    std::fill(values.get() + begin, values.get() + end, 0.0F);
  });
  plane_floats = floats;
}

void ViewBuffers::Prepare(int width, int height, bool geometry, bool foreground, bool training,
                          ThreadPool* threads) {
  const size_t tiles_x = (width + kTileSize - 1) / kTileSize;
  const size_t tiles_y = (height + kTileSize - 1) / kTileSize;
  const size_t stride = tiles_x * kTileSize + 2 * kMargin;
  const size_t plane_floats = stride * tiles_y * kTileSize + 2 * kMargin;
  if (width != width_ || height != height_) {
    for (Block* block : {&drawn_, &geometry_, &training_, &training_geometry_}) block->plane_floats = 0;
    width_ = width;
    height_ = height;
  }
  if (stop_capacity_ < plane_floats) {
    stop_.reset(new int32_t[plane_floats]);
    stop_capacity_ = plane_floats;
  }
  drawn_.Use(kNumDrawn, plane_floats, threads);
  if (geometry) geometry_.Use(kNumGeometry, plane_floats, threads);
  if (training) training_.Use(kNumTraining, plane_floats, threads);
  if (training && geometry) training_geometry_.Use(kNumTrainingGeometry, plane_floats, threads);
  planes_ = {};
  planes_.stride = stride;
  SetPlanes(geometry, foreground, training);
}

void ViewBuffers::SetPlanes(bool geometry, bool foreground, bool training) {
  gradients_ = {};
  planes_.transmittance = drawn_.Plane(kTransmittance);
  planes_.stop = stop_.get();
  if (foreground) planes_.foreground = drawn_.Plane(kForeground);
  for (int c = 0; c < 3; ++c) planes_.color[c] = drawn_.Plane(kColor + c);
  if (geometry) {
    for (int c = 0; c < 3; ++c) planes_.normal[c] = geometry_.Plane(kNormal + c);
    planes_.weight = geometry_.Plane(kWeight);
    planes_.depth = geometry_.Plane(kDepth);
    planes_.median = geometry_.Plane(kMedian);
    planes_.distortion = geometry_.Plane(kDistortion);
    planes_.m1 = geometry_.Plane(kM1);
    planes_.m2 = geometry_.Plane(kM2);
  }
  if (!training) return;
  for (int c = 0; c < 3; ++c) gradients_.color[c] = training_.Plane(kByColor + c);
  gradients_.alpha = training_.Plane(kByAlpha);
  if (foreground) gradients_.foreground = training_.Plane(kByForeground);
  if (geometry) {
    for (int c = 0; c < 3; ++c) gradients_.normal[c] = training_geometry_.Plane(kByNormal + c);
    gradients_.expected_depth = training_geometry_.Plane(kByDepth);
    gradients_.distortion = training_geometry_.Plane(kByDistortion);
  }
}

}  // namespace s2gs
