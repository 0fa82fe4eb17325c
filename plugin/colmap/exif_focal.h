#pragma once

#include <filesystem>
#include <optional>
#include <string_view>

namespace s2gs {

/// What a photo's EXIF says of the focal length; zero where it says nothing.
struct ExifFocal {
  double focal_mm = 0;       ///< of the lens.
  double focal_35mm_mm = 0;  ///< for a film of 36 mm x 24 mm.
  bool operator==(const ExifFocal& other) const {
    return focal_mm == other.focal_mm && focal_35mm_mm == other.focal_35mm_mm;
  }
};

/// From the first bytes of a JPEG file; nothing when there is no readable EXIF. Never throws: damaged EXIF is
/// as good as none.
std::optional<ExifFocal> ParseExifFocal(std::string_view jpeg);

/// The same from a file.
std::optional<ExifFocal> ReadExifFocal(const std::filesystem::path& path);

}  // namespace s2gs
