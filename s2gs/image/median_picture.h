#pragma once

#include <vector>

#include "s2gs/image/image_file.h"

namespace s2gs {

/// Medians of each channel (MedianOfPictures). \param photos  of one size, RGB; at least one.
Image8 MedianPicture(const std::vector<Image8>& photos);

}  // namespace s2gs
