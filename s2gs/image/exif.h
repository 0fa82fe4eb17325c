#pragma once

#include <array>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>

#include "s2gs/image/image_file.h"

namespace s2gs {

/// What a photo's EXIF says of its lens and of how the camera was held; zero where it says nothing.
struct ExifTags {
  double focal_mm = 0;            ///< of the lens.
  double focal_35mm_mm = 0;       ///< for a film of 36 mm x 24 mm, by the diagonal; includes digital zoom.
  double digital_zoom = 0;        ///< ratio; 1 is none.
  double plane_px_per_mm = 0;     ///< pixels a millimetre of the sensor, without digital zoom.
  std::array<int, 2> taken = {};  ///< width and height when it was taken [px], before any crop or resizing.
  int orientation = 1;            ///< 1 to 8, TIFF's: what turns the stored pixels upright.

  /// Whether both describe the same lens at the same focal length, whatever way the camera was held.
  bool HasLensOf(const ExifTags& other) const {
    return focal_mm == other.focal_mm && focal_35mm_mm == other.focal_35mm_mm &&
           digital_zoom == other.digital_zoom;
  }
  bool SaysOfLens() const { return focal_mm > 0 || focal_35mm_mm > 0; }
};

/// From the first bytes of a JPEG or PNG file (as long as EXIF comes before the pixels), or from a block of
/// EXIF of another format ("Exif", two zeros, a TIFF header; or that header at once). Nothing when there is
/// no readable EXIF. Never throws: damaged EXIF is as good as none.
std::optional<ExifTags> ParseExif(std::string_view bytes);

/// The same from a file.
std::optional<ExifTags> ReadExif(const std::filesystem::path& path);

/// Pixels a millimetre for EXIF's resolution and its unit (2: inch, 3: centimetre, 0 where nothing is said:
/// inch); 0 for units that EXIF does not have.
double PixelsPerMillimetre(double resolution, double unit);

/// EXIF as a PNG's eXIf chunk has it: a TIFF header and the tags that are known.
std::string MakeExif(const ExifTags& tags);

/// Whether a photo of this size is a part of what the camera took: it has another shape than was taken.
bool IsCut(const ExifTags& tags, const ImageSize& size);

/// The focal length in pixels of a photo of this size; nothing when the tags do not tell. A photo that
/// was cut is taken to have kept its pixels, others at most to have been resized; a focal length for 35 mm
/// film is for the diagonal of the photo as taken (CIPA DCG-001), and stands above the sensor's resolution.
std::optional<double> FocalPixels(const ExifTags& tags, const ImageSize& size);

/// Whether an orientation mirrors.
constexpr bool IsMirrored(int orientation) {
  return orientation == 2 || orientation == 4 || orientation == 5 || orientation == 7;
}

/// The pixels as they are meant to be looked at. \param orientation  1 to 8; others count as 1.
Image8 TurnUpright(const Image8& image, int orientation);

/// The image mirrored left to right.
Image8 MirrorRows(const Image8& image);

/// The orientation of MirrorRows() of an image whose orientation mirrors: one of 1, 3, 6, 8.
int OrientationOfMirrored(int orientation);

/// The orientation by a file's EXIF; 1 where it says nothing. Never throws.
int ReadOrientation(const std::filesystem::path& path);

}  // namespace s2gs
