#pragma once

#include <cstdint>
#include <filesystem>

#include "s2gs/image/image_file.h"

namespace s2gs {

/// What the header of a JPEG or PNG file says.
struct ImageHeader {
  ImageSize size;
  bool is_jpeg = false;    ///< else PNG.
  uint64_t num_bytes = 0;  ///< up to and including what gives the size: thumbnails come before it.
};

/// Reads the header alone; the pixels may still turn out damaged. Throws UserError like ReadImage.
ImageHeader ReadImageHeader(const std::filesystem::path& path);

}  // namespace s2gs
