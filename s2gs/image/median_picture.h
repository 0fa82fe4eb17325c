#pragma once

#include <cstddef>
#include <vector>

#include "s2gs/image/image_file.h"

namespace s2gs {

/// Of a camera that stands still: of fewer photos what turns is in their median.
constexpr size_t kPhotosForMedian = 8;

/// Medians of each channel. \param photos  of one size, RGB; at least one.
Image8 MedianPicture(const std::vector<Image8>& photos);

}  // namespace s2gs
