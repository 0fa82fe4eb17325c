#pragma once

#include <Eigen/Core>
#include <array>

#include "s2gs/image/image_file.h"

namespace s2gs {

/// An image's value in each channel between the centres of its pixels.
/// \param at  [px], centres at .5; the four centres about it are the image's.
template <int kChannels>
std::array<float, kChannels> Bilinear(const Image8& image, const Eigen::Vector2d& at) {
  const double u = at.x() - 0.5;
  const double v = at.y() - 0.5;
  const auto x = static_cast<int>(u);
  const auto y = static_cast<int>(v);
  const auto fx = static_cast<float>(u - x);
  const auto fy = static_cast<float>(v - y);
  std::array<float, kChannels> color = {};
  for (int c = 0; c < kChannels; ++c) {
    const float above = (1 - fx) * image.Pixel(x, y)[c] + fx * image.Pixel(x + 1, y)[c];
    const float below = (1 - fx) * image.Pixel(x, y + 1)[c] + fx * image.Pixel(x + 1, y + 1)[c];
    color[c] = (1 - fy) * above + fy * below;
  }
  return color;
}

/// Of an RGB image.
inline std::array<float, 3> BilinearColor(const Image8& image, const Eigen::Vector2d& at) {
  return Bilinear<3>(image, at);
}

}  // namespace s2gs
