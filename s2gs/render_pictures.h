#pragma once

#include <cstddef>
#include <vector>

#include "s2gs/backend/backend.h"
#include "s2gs/image/image_error.h"
#include "s2gs/image/image_file.h"

namespace s2gs {

/// 255 inside, 0 outside; one channel.
Image8 MaskImage(const PixelMask& mask);

/// Depths in false colours from near (red) to far (blue), 0 black, between the smallest and the largest of
/// the image.
Image8 DepthPicture(const std::vector<float>& depth, int width, int height);

/// Unit normals as colours, (n + 1) / 2, with y up and z towards the viewer; nothing is black.
Image8 NormalPicture(const RenderedView& view);

/// The map of p in grey, one channel: 255 where all that shows rotates.
Image8 ForegroundPicture(const RenderedView& view);

/// Which of so many photos an overview shows: at most four, spread evenly, ascending.
std::vector<size_t> OverviewPhotos(size_t num_photos);

/// Photo, rendering, absolute error (four times) and photo with the mask's outside darkened, side by side.
/// All of one size; if the photo's differs, it is resized.
Image8 ComparisonPicture(const Image8& photo, const Image8& rendered, const Image8& mask);

}  // namespace s2gs
