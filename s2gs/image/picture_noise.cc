#include "s2gs/image/picture_noise.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <utility>
#include <vector>

#include "s2gs/image/photos.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

constexpr float kMinNoise = 0.5F;   // [grey levels], of rounding.
constexpr float kNoiseFactor = 3;   // standard deviations.
constexpr size_t kNoiseStride = 7;  // of the pixels that noise is measured from.
constexpr float kPhotoNoise = 2;    // [grey levels], at least: what the mesh's refinement is blind to

}  // namespace

float MostDifferentChannel(const uint8_t* a, const uint8_t* b) {
  int most = 0;
  for (int c = 0; c < 3; ++c) most = std::max(most, std::abs(a[c] - b[c]));
  return static_cast<float>(most);
}

float SlopeAt(const Image8& image, int x, int y) {
  return (MostDifferentChannel(image.Pixel(x - 1, y), image.Pixel(x + 1, y)) +
          MostDifferentChannel(image.Pixel(x, y - 1), image.Pixel(x, y + 1))) /
         2;
}

float TextureAt(const Image8& image, int x, int y, int radius) {
  const double side = 2 * radius + 1;
  const double count = side * side;
  const double squares_along = count * (side * side - 1) / 12;  // sum of u^2 over the patch
  double sum = 0;
  double along_x = 0;
  double along_y = 0;
  double squares = 0;
  for (int v = -radius; v <= radius; ++v) {
    for (int u = -radius; u <= radius; ++u) {
      const double grey = GreyFromRgb(image.Pixel(x + u, y + v));
      sum += grey;
      along_x += u * grey;
      along_y += v * grey;
      squares += grey * grey;
    }
  }
  const double left = squares - sum * sum / count - (along_x * along_x + along_y * along_y) / squares_along;
  return static_cast<float>(std::sqrt(std::max(0.0, left) / (count - 3)));
}

float LeastTexture(const PictureNoise& noise) {
  return kTextureFactor * std::max(kPhotoNoise, noise.of_grey);
}

PictureNoise MeasurePictureNoise(const Image8* pictures, size_t count) {
  std::vector<float> of_slopes;
  std::vector<float> of_colors;
  const size_t half = count / 2;
  for (size_t i = 0; i + half < count; ++i) {
    const std::vector<uint8_t>& a = pictures[i].pixels;
    const std::vector<uint8_t>& b = pictures[i + half].pixels;
    for (size_t p = 0; 3 * p + 5 < a.size(); p += kNoiseStride) {
      of_colors.push_back(MostDifferentChannel(&a[3 * p], &b[3 * p]));
      const int slope_a = GreyFromRgb(&a[3 * p + 3]) - GreyFromRgb(&a[3 * p]);
      const int slope_b = GreyFromRgb(&b[3 * p + 3]) - GreyFromRgb(&b[3 * p]);
      of_slopes.push_back(static_cast<float>(std::abs(slope_a - slope_b)) / 2);  // four pixels' noise
    }
  }
  PictureNoise noise = {kMinNoise, kNoiseFactor * kMinNoise};
  if (of_slopes.empty()) return noise;
  noise.of_grey = std::max(kMinNoise, static_cast<float>(kSigmaOfMad) * Quantile(std::move(of_slopes), 0.5));
  noise.tolerance = kNoiseFactor * std::max(kMinNoise, static_cast<float>(kSigmaOfMad) *
                                                           Quantile(std::move(of_colors), 0.5));
  return noise;
}

}  // namespace s2gs
