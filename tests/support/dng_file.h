#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <functional>

namespace s2gs {

/// A raw photo as a camera writes it.
struct DngPhoto {
  int width = 0;
  int height = 0;
  /// Linear light in the primaries of sRGB, from 0 to 1, at a pixel (x, y).
  std::function<std::array<double, 3>(int, int)> light;
  int orientation = 1;
  double focal_mm = 0;
  /// The part that the camera means to be shown: x, y, width and height [px]; all of it where width is 0.
  std::array<int, 4> crop{};
};

/// Writes a little-endian DNG 1.4: one Bayer mosaic (red, green; green, blue) of 16 bits, not compressed,
/// with the tags that a developer needs (Adobe, Digital Negative Specification 1.4).
void WriteDng(const std::filesystem::path& path, const DngPhoto& photo);

}  // namespace s2gs
