#pragma once

#include <cstdint>
#include <filesystem>

#include "s2gs/image/image_file.h"

namespace s2gs {

/// What a PNG's header says of its pixels.
struct PngPixels {
  int bits = 8;            ///< of a channel.
  bool has_alpha = false;  ///< a channel of its own; transparent colours of a palette do not count.
};

/// What the header of a JPEG or PNG file says.
struct ImageHeader {
  ImageSize size;
  bool is_jpeg = false;    ///< else PNG.
  PngPixels png;           ///< of a PNG.
  uint64_t num_bytes = 0;  ///< up to and including what gives the size: thumbnails come before it.
};

/// Reads the header alone; the pixels may still turn out damaged. Throws UserError like ReadImage.
ImageHeader ReadImageHeader(const std::filesystem::path& path);

}  // namespace s2gs
