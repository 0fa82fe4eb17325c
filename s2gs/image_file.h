#pragma once

#include <cstdint>
#include <filesystem>
#include <vector>

namespace s2gs {

/// An 8-bit image in memory, rows from top to bottom, channels interleaved.
struct Image8 {
  int width = 0;                ///< [px]
  int height = 0;               ///< [px]
  int channels = 0;             ///< 1 grey, 3 RGB.
  std::vector<uint8_t> pixels;  ///< height * width * channels values.

  const uint8_t* Pixel(int x, int y) const {
    return pixels.data() + (static_cast<size_t>(y) * width + x) * channels;
  }
  uint8_t* Pixel(int x, int y) { return pixels.data() + (static_cast<size_t>(y) * width + x) * channels; }
};

/// Decodes a JPEG or PNG file, told apart by content, into `channels` (1 or 3) channels of 8 bits.
/// 16-bit PNGs are reduced, alpha is dropped, EXIF orientation is not applied (COLMAP does not either).
/// Throws UserError for missing, truncated or damaged files: a short decode is never accepted.
Image8 ReadImage(const std::filesystem::path& path, int channels);

/// Encodes by the extension (.png, .jpg, .jpeg), atomically. \param jpeg_quality 1 to 100.
void WriteImage(const std::filesystem::path& path, const Image8& image, int jpeg_quality = 95);

}  // namespace s2gs
