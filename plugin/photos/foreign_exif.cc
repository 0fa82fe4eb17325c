#include "plugin/photos/foreign_exif.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <string>

#include "s2gs/image/image_file.h"

namespace s2gs {
namespace {

constexpr size_t kMaxExifBytes = size_t{1} << 16;

}  // namespace

ExifTags TagsOf(const OIIO::ImageSpec& spec) {
  ExifTags tags;
  const auto number = [&](const char* name) {
    const OIIO::ParamValue* value = spec.find_attribute(name);
    if (value == nullptr) return 0.0;
    const double as_float = value->get_float();
    const double given = as_float != 0 ? as_float : value->get_int();  // which alone knows short integers
    return std::isfinite(given) && given > 0 ? given : 0.0;
  };
  tags.focal_mm = number("Exif:FocalLength");
  tags.focal_35mm_mm = number("Exif:FocalLengthIn35mmFilm");
  tags.digital_zoom = number("Exif:DigitalZoomRatio");
  tags.plane_px_per_mm =
      PixelsPerMillimetre(number("Exif:FocalPlaneXResolution"), number("Exif:FocalPlaneResolutionUnit"));
  const auto side = [&](const char* name) {
    return std::clamp(spec.get_int_attribute(name, 0), 0, static_cast<int>(kMaxImageSide));
  };
  tags.taken = {side("Exif:PixelXDimension"), side("Exif:PixelYDimension")};
  const int orientation = spec.get_int_attribute("Orientation", 1);
  if (orientation >= 1 && orientation <= 8) tags.orientation = orientation;
  return tags;
}

std::optional<ExifTags> FindExif(std::string_view bytes, bool is_heif) {
  // HEIC: the length of what stands before the TIFF header, "Exif" and two zeros or nothing, and that header.
  constexpr std::array<std::string_view, 4> kMarks = {
      std::string_view("\0\0\0\6Exif\0\0II*\0", 14), std::string_view("\0\0\0\6Exif\0\0MM\0*", 14),
      std::string_view("\0\0\0\0II*\0\x08\0\0\0", 12), std::string_view("\0\0\0\0MM\0*\0\0\0\x08", 12)};
  for (const std::string_view mark : kMarks) {
    const size_t found = is_heif ? bytes.find(mark) : std::string_view::npos;
    if (found != std::string_view::npos) return ParseExif(bytes.substr(found + 4, kMaxExifBytes));
  }
  // WebP: a chunk of its own, its length, then TIFF.
  const size_t at = bytes.substr(0, 4) == "RIFF" ? bytes.find("EXIF") : std::string_view::npos;
  if (at == std::string_view::npos || bytes.size() - at < 8) return std::nullopt;
  return ParseExif(bytes.substr(at + 8, kMaxExifBytes));
}

}  // namespace s2gs
