#pragma once

#include <cstdint>
#include <filesystem>
#include <string_view>
#include <vector>

namespace s2gs {

/// An 8-bit image in memory, rows from top to bottom, channels interleaved.
struct Image8 {
  int width = 0;                ///< [px]
  int height = 0;               ///< [px]
  int channels = 0;             ///< 1 grey, 3 RGB, 4 RGB and alpha (only to write as PNG).
  std::vector<uint8_t> pixels;  ///< height * width * channels values.

  const uint8_t* Pixel(int x, int y) const {
    return pixels.data() + (static_cast<size_t>(y) * width + x) * channels;
  }
  uint8_t* Pixel(int x, int y) { return pixels.data() + (static_cast<size_t>(y) * width + x) * channels; }
};

struct ImageSize {
  int width = 0;   ///< [px]
  int height = 0;  ///< [px]
};

/// Bounds of what is decoded and encoded; larger images are refused before anything is allocated.
constexpr int kMaxImageSide = 65500;                    ///< [px], JPEG's own.
constexpr int64_t kMaxImagePixels = int64_t{1} << 28;   ///< 268 megapixels.
constexpr uint64_t kMaxImageBytes = uint64_t{1} << 30;  ///< of the file.

/// Decodes a JPEG or PNG file, told apart by content, into `channels` (1 or 3) channels of 8 bits.
/// 16-bit PNGs are scaled to 8 bits with rounding, alpha is dropped, EXIF orientation, colour profiles and
/// gamma are not applied (COLMAP does not either). Colour becomes grey by Rec. 601,
/// .299 R + .587 G + .114 B (for JPEG: its own luma channel), as OpenCV does; grey becomes RGB by copying.
/// Throws UserError for missing, truncated or damaged files: a short decode is never accepted, and neither
/// is a JPEG about which the decoder warns, or a file too short for the size that it claims. CMYK and
/// arithmetic-coded JPEGs are not supported.
Image8 ReadImage(const std::filesystem::path& path, int channels);

/// The same for a file in memory. \param path  for messages only.
Image8 DecodeImage(std::string_view bytes, const std::filesystem::path& path, int channels);

/// The mask that a JPEG or PNG file holds, in one channel: its alpha channel where it has one that is not
/// opaque all over (a photo that was cut out), else ReadImage in grey. Throws like ReadImage.
Image8 ReadMask(const std::filesystem::path& path);

/// Width and height from the header of a JPEG or PNG file; the pixels may still turn out damaged.
/// Throws UserError like ReadImage.
ImageSize ReadImageSize(const std::filesystem::path& path);

/// Encodes by the extension (.png, .jpg, .jpeg, in either case), atomically. From quality 90 on, JPEGs keep
/// their colours at full resolution.
/// \param jpeg_quality  1 to 100.
/// Throws UserError for other extensions and for images over the bounds above.
void WriteImage(const std::filesystem::path& path, const Image8& image, int jpeg_quality = 95);

/// Encodes as PNG whatever the extension, atomically, with EXIF as MakeExif (exif.h) gives it.
/// Throws UserError for images over the bounds above.
void WritePng(const std::filesystem::path& path, const Image8& image, std::string_view exif);

/// Rec. 601, rounded: .299 R + .587 G + .114 B.
inline uint8_t GreyFromRgb(const uint8_t* rgb) {
  return static_cast<uint8_t>((19595U * rgb[0] + 38470U * rgb[1] + 7471U * rgb[2] + 32768U) >> 16);
}

/// An RGB image in one channel, by GreyFromRgb.
Image8 GreyImage(const Image8& rgb);

}  // namespace s2gs
