#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "s2gs/backend/backend.h"
#include "s2gs/image/image_error.h"
#include "s2gs/scene/training_scene.h"

namespace s2gs {

/// Means over the held-out photos. NaN where nothing could be measured.
struct HeldOutErrors {
  int64_t num_photos = 0;
  double psnr = 0;         ///< whole frame [dB]
  double ssim = 0;         ///< whole frame
  double object_psnr = 0;  ///< pixels of the rotating part by the true mask [dB]
  double object_ssim = 0;
  double mask_iou = 0;  ///< rendered mask of the rotating part against the true one.
};

/// Renders the held-out photos and compares: PSNR and SSIM as image_error.h defines them, on 8-bit images.
HeldOutErrors MeasureHeldOut(const TrainingScene& scene, Backend* backend);

/// A rendered view in 8 bits, clamped and rounded.
Image8 ToImage8(const RenderedView& view);

}  // namespace s2gs
