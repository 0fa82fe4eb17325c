#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "s2gs/image/exif.h"
#include "s2gs/image/image_file.h"

namespace s2gs {

/// Photos of formats that neither COLMAP nor our own readers take, through OpenImageIO: TIFF, HEIC, AVIF,
/// WebP, BMP, EXR, raw files of cameras and more, and PNG of 16 bits.

/// Why this program cannot read such photos at all, as the end of a sentence; nothing when it can.
std::optional<std::string> WhyNoForeignPhotos();

/// The size by the file's header. Throws UserError, which says what would read the file, when it is of an
/// unknown kind or damaged, and for sizes out of bounds.
ImageSize ReadForeignSize(const std::filesystem::path& path);

struct ForeignPhoto {
  Image8 image;  ///< as stored; RGB, with alpha where the file's is not opaque all over.
  ExifTags tags;
  std::string color;  ///< what was done to its colours, for the log; empty: nothing.
};

/// Decodes a photo to sRGB of 8 bits: 16 bits are rounded; numbers that are proportional to light (EXR, HDR)
/// get sRGB's curve, 1 becoming white; an RGB or grey profile that the file carries is converted from
/// (relative colorimetric), where OpenImageIO gives it; raw files are developed with the camera's white
/// balance and no brightening. HEIC and AVIF come as their file turns them, others as they are stored. Throws
/// UserError for damaged and truncated files.
ForeignPhoto ReadForeignPhoto(const std::filesystem::path& path);

}  // namespace s2gs
