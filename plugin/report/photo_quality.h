#pragma once

#include <string>
#include <vector>

#include "s2gs/image/image_file.h"

namespace s2gs {

/// What a photo's pixels say of how it was taken.
struct PhotoQuality {
  bool is_read = false;
  double blur_px = 0;     ///< standard deviation of the blur of its edges [px]; infinite without any edge.
  double brightness = 0;  ///< mean grey value, 0 to 1, as coded.
  double bright_pct = 0;  ///< pixels at 254 or above: nothing can be told from them [%].
  double dark_pct = 0;    ///< pixels at 1 or below [%].
};

/// Blur from the ratio of the grey values' squared gradients to their squared Laplacians: for an edge blurred
/// by a Gaussian of standard deviation s it is 2 s^2, whatever the edge's height. Measured on the rotating
/// part, which is what a turning table blurs; brightness on the rest, which does not change while the table
/// turns.
/// \param grey  one channel.
/// \param mask  one channel, of any size, 255 for the rotating part; null or without either side: the whole.
PhotoQuality MeasurePhoto(const Image8& grey, const Image8* mask);

/// A photo that stands out among those of its station.
struct PhotoWarning {
  size_t photo = 0;  ///< its place in the list.
  std::string text;
};

/// Compares each photo with the median of its station's. A photo is warned about when chance alone (a normal
/// distribution with the station's own spread, from the median absolute deviation) would give such a one less
/// than once in twenty scans, and when the difference matters: half a pixel of additional blur, or a third of
/// a stop, a camera's smallest step, taking grey values as coded with gamma 2.2. Stations of fewer than five
/// photos have no spread to go by.
std::vector<PhotoWarning> FindPhotoWarnings(const std::vector<PhotoQuality>& photos,
                                            const std::vector<int>& stations);

}  // namespace s2gs
