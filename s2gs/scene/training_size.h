#pragma once

#include <cstdint>

namespace s2gs {

/// What the memory of a training depends on, known before the first photo is read.
struct TrainingSize {
  int64_t num_photos = 0;
  int64_t num_points = 0;       ///< of the sparse models.
  int64_t photo_bytes = 0;      ///< of all photos and masks, at their sizes in training.
  int64_t trained_bytes = 0;    ///< of those that are trained on.
  int64_t largest_view_px = 0;  ///< width * height in training.
  int longest_side_px = 0;      ///< of the same.
  int64_t loading_bytes = 0;    ///< of the photos that are read at the same time, at the files' sizes.
};

}  // namespace s2gs
