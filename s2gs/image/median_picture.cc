#include "s2gs/image/median_picture.h"

#include <cstdint>

#include "sfm_split/base/error.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {

Image8 MedianPicture(const std::vector<Image8>& photos) {
  S2GS_INVARIANT(!photos.empty());
  Image8 median = photos.front();
  const auto row = static_cast<size_t>(median.width) * median.channels;
  ParallelFor(median.height, 0, [&](int64_t y) {
    std::vector<uint8_t> values(photos.size());
    for (size_t i = row * static_cast<size_t>(y); i < row * static_cast<size_t>(y + 1); ++i) {
      for (size_t k = 0; k < photos.size(); ++k) values[k] = photos[k].pixels[i];
      median.pixels[i] = UpperMedian(values);
    }
  });
  return median;
}

}  // namespace s2gs
