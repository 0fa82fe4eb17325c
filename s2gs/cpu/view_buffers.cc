#include "s2gs/cpu/view_buffers.h"

namespace s2gs {

void ViewBuffers::Prepare(int width, int height, bool geometry, bool foreground, bool training) {
  const int num_planes = geometry ? kNumPlanes : kNormal;
  const size_t tiles_x = (width + kTileSize - 1) / kTileSize;
  const size_t tiles_y = (height + kTileSize - 1) / kTileSize;
  const size_t stride = tiles_x * kTileSize + 2 * kMargin;
  if (width != width_ || height != height_) {
    values_.clear();
    width_ = width;
    height_ = height;
  }
  plane_floats_ = stride * tiles_y * kTileSize + 2 * kMargin;
  if (values_.size() < plane_floats_ * num_planes) values_.resize(plane_floats_ * num_planes, 0.0F);
  stop_.resize(plane_floats_);

  planes_ = {};
  gradients_ = {};
  planes_.stride = stride;
  planes_.transmittance = Plane(kTransmittance);
  planes_.stop = stop_.data();
  if (foreground) planes_.foreground = Plane(kForeground);
  for (int c = 0; c < 3; ++c) planes_.color[c] = Plane(kColor + c);
  if (geometry) {
    for (int c = 0; c < 3; ++c) planes_.normal[c] = Plane(kNormal + c);
    planes_.weight = Plane(kWeight);
    planes_.depth = Plane(kDepth);
    planes_.median = Plane(kMedian);
    planes_.distortion = Plane(kDistortion);
    planes_.m1 = Plane(kM1);
    planes_.m2 = Plane(kM2);
  }
  if (!training) return;
  for (int c = 0; c < 3; ++c) gradients_.color[c] = Plane(kByColor + c);
  gradients_.alpha = Plane(kByAlpha);
  if (foreground) gradients_.foreground = Plane(kByForeground);
  if (geometry) {
    for (int c = 0; c < 3; ++c) gradients_.normal[c] = Plane(kByNormal + c);
    gradients_.expected_depth = Plane(kByDepth);
    gradients_.distortion = Plane(kByDistortion);
  }
}

}  // namespace s2gs
