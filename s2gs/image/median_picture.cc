#include "s2gs/image/median_picture.h"

#include <cstddef>
#include <cstdint>

#include "sfm_split/base/error.h"
#include "sfm_split/base/median_of_pictures.h"

namespace s2gs {

Image8 MedianPicture(const std::vector<Image8>& photos) {
  S2GS_INVARIANT(!photos.empty());
  Image8 median = photos.front();
  std::vector<const std::vector<uint8_t>*> pixels;
  pixels.reserve(photos.size());
  for (const Image8& photo : photos) pixels.push_back(&photo.pixels);
  median.pixels = MedianOfPictures(pixels, static_cast<size_t>(median.width) * median.channels);
  return median;
}

}  // namespace s2gs
