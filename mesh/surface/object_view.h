#pragma once

#include "s2gs/image/photos.h"
#include "sfm_split/base/rigid3.h"

namespace s2gs {

/// A pinhole camera, COLMAP's pixel convention.
struct ObjectView {
  int width = 0;   ///< [px]
  int height = 0;  ///< [px]
  double fx = 0;   ///< [px], as the next three.
  double fy = 0;
  double cx = 0;
  double cy = 0;
  Rigid3 cam_from_object;
};

/// The camera of CutAndShrink's picture.
ObjectView CutAndShrunk(const ObjectView& view, const ImagePart& part, int factor);

}  // namespace s2gs
