#include "s2gs/image/exif.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <fstream>
#include <utility>
#include <vector>

#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

constexpr size_t kMaxBytes = size_t{1} << 17;  // EXIF comes first and is 64 kB at most
constexpr int kMaxEntries = 1000;
constexpr double kFilmDiagonalMm = 43.26661530556787;  // of 36 mm x 24 mm
// Shapes that differ by less come from rounding when a photo was resized.
constexpr double kMaxShapeError = 0.01;

enum Tag : uint16_t {
  kOrientation = 0x0112,
  kExifFolder = 0x8769,
  kFocalLength = 0x920A,
  kPixelXDimension = 0xA002,
  kPixelYDimension = 0xA003,
  kFocalPlaneXResolution = 0xA20E,
  kFocalPlaneResolutionUnit = 0xA210,
  kDigitalZoomRatio = 0xA404,
  kFocalLength35mm = 0xA405
};
enum Type : uint16_t { kShort = 3, kLong = 4, kRational = 5 };

// A TIFF file in memory. Reads outside it are 0, which no tag is.
class Tiff {
 public:
  explicit Tiff(std::string_view bytes) : bytes_(bytes), is_big_endian_(bytes.substr(0, 2) == "MM") {}

  bool IsValid() const {
    return (bytes_.substr(0, 2) == "MM" || bytes_.substr(0, 2) == "II") && Read(2, 2) == 42;
  }
  uint32_t Read(size_t offset, size_t size) const {
    if (offset > bytes_.size() || bytes_.size() - offset < size) return 0;
    uint32_t value = 0;
    for (size_t i = 0; i < size; ++i) {
      const auto byte = static_cast<uint8_t>(bytes_[offset + (is_big_endian_ ? i : size - 1 - i)]);
      value = (value << 8U) | byte;
    }
    return value;
  }
  // The offset of a tag's entry in the folder at `folder`; 0 when it has none.
  size_t Find(size_t folder, Tag tag) const {
    const uint32_t count = Read(folder, 2);
    for (uint32_t i = 0; i < count && i < kMaxEntries; ++i) {
      const size_t entry = folder + 2 + size_t{12} * i;
      if (Read(entry, 2) == tag) return entry;
    }
    return 0;
  }
  double Number(size_t entry) const {
    if (entry == 0) return 0;
    switch (Read(entry + 2, 2)) {
      case kShort:
        return Read(entry + 8, 2);
      case kLong:
        return Read(entry + 8, 4);
      case kRational: {
        const size_t at = Read(entry + 8, 4);
        const uint32_t divisor = Read(at + 4, 4);
        return divisor == 0 ? 0.0 : static_cast<double>(Read(at, 4)) / divisor;
      }
      default:
        return 0;
    }
  }

 private:
  std::string_view bytes_;
  bool is_big_endian_;
};

std::optional<ExifTags> ParseTiff(std::string_view bytes) {
  const Tiff tiff(bytes);
  if (!tiff.IsValid()) return std::nullopt;
  ExifTags tags;
  const size_t first = tiff.Read(4, 4);
  const double orientation = tiff.Number(tiff.Find(first, kOrientation));
  if (orientation >= 1 && orientation <= 8) tags.orientation = static_cast<int>(orientation);
  const size_t folder_entry = tiff.Find(first, kExifFolder);
  if (folder_entry == 0) return tags;
  const size_t folder = tiff.Read(folder_entry + 8, 4);
  const auto number = [&](Tag tag) { return tiff.Number(tiff.Find(folder, tag)); };
  tags.focal_mm = number(kFocalLength);
  tags.focal_35mm_mm = number(kFocalLength35mm);
  tags.digital_zoom = number(kDigitalZoomRatio);
  tags.plane_px_per_mm =
      PixelsPerMillimetre(number(kFocalPlaneXResolution), number(kFocalPlaneResolutionUnit));
  const auto side = [&](Tag tag) { return static_cast<int>(std::min<double>(number(tag), kMaxImageSide)); };
  tags.taken = {side(kPixelXDimension), side(kPixelYDimension)};
  return tags;
}

std::optional<ExifTags> ParseJpeg(std::string_view jpeg) {
  const auto byte = [&](size_t i) { return static_cast<uint8_t>(jpeg[i]); };
  for (size_t at = 2; at + 4 <= jpeg.size() && byte(at) == 0xFF;) {
    const uint8_t marker = byte(at + 1);
    if (marker == 0xDA || marker == 0xD9) break;  // the pixels begin
    const size_t length = (size_t{byte(at + 2)} << 8U) | byte(at + 3);
    if (length < 2) break;
    const std::string_view segment = jpeg.substr(at + 4, length - 2);
    constexpr std::string_view kExif("Exif\0\0", 6);
    if (marker == 0xE1 && segment.substr(0, kExif.size()) == kExif) {
      return ParseTiff(segment.substr(kExif.size()));
    }
    at += 2 + length;
  }
  return std::nullopt;
}

std::optional<ExifTags> ParsePng(std::string_view png) {
  const auto number = [&](size_t at) {
    size_t value = 0;
    for (size_t i = 0; i < 4; ++i) value = (value << 8U) | static_cast<uint8_t>(png[at + i]);
    return value;
  };
  for (size_t at = 8; at + 8 <= png.size();) {
    const size_t length = number(at);
    const std::string_view kind = png.substr(at + 4, 4);
    if (kind == "eXIf") return ParseTiff(png.substr(at + 8, length));
    if (kind == "IEND" || length > kMaxBytes) break;
    at += 12 + length;
  }
  return std::nullopt;
}

// Width and height as taken, the way round that the pixels are stored: they may have been turned since.
std::pair<double, double> TakenAsStored(const ExifTags& tags, const ImageSize& size) {
  const double width = tags.taken[0];
  const double height = tags.taken[1];
  if ((width > height) == (size.width > size.height)) return {width, height};
  return {height, width};
}

// --- Writing -----------------------------------------------------------------------------------------------

// Little-endian TIFF: folders of entries, then what does not fit into one.
class TiffWriter {
 public:
  struct Entry {
    Tag tag;
    Type type;
    uint32_t value;
    uint32_t divisor = 1;
  };

  static std::string Write(const std::vector<Entry>& first, const std::vector<Entry>& exif) {
    TiffWriter writer;
    const size_t first_bytes = 2 + 12 * (first.size() + 1) + 4;
    const size_t exif_at = 8 + first_bytes;
    const size_t values_at = exif_at + 2 + 12 * exif.size() + 4;
    writer.bytes_ = "II";
    writer.Add(42, 2);
    writer.Add(8, 4);
    writer.Add(static_cast<uint32_t>(first.size() + 1), 2);
    for (const Entry& entry : first) writer.AddEntry(entry, values_at);
    writer.AddEntry({kExifFolder, kLong, static_cast<uint32_t>(exif_at)}, values_at);
    writer.Add(0, 4);
    writer.Add(static_cast<uint32_t>(exif.size()), 2);
    for (const Entry& entry : exif) writer.AddEntry(entry, values_at);
    writer.Add(0, 4);
    return writer.bytes_ + writer.values_;
  }

 private:
  static std::string Number(uint32_t value, int size) {
    std::string text;
    for (int i = 0; i < size; ++i)
      text += static_cast<char>((value >> (8U * static_cast<unsigned>(i))) & 0xFFU);
    return text;
  }
  void Add(uint32_t value, int size) { bytes_ += Number(value, size); }
  void AddEntry(const Entry& entry, size_t values_at) {
    Add(entry.tag, 2);
    Add(entry.type, 2);
    Add(1, 4);
    if (entry.type == kRational) {
      Add(static_cast<uint32_t>(values_at + values_.size()), 4);
      values_ += Number(entry.value, 4) + Number(entry.divisor, 4);
    } else if (entry.type == kShort) {
      Add(entry.value, 2);
      Add(0, 2);
    } else {
      Add(entry.value, 4);
    }
  }

  std::string bytes_;
  std::string values_;
};

}  // namespace

std::optional<ExifTags> ParseExif(std::string_view bytes) {
  constexpr std::string_view kExif("Exif\0\0", 6);
  if (bytes.substr(0, 2) == "\xFF\xD8") return ParseJpeg(bytes);
  if (bytes.substr(0, 8) == "\x89PNG\r\n\x1A\n") return ParsePng(bytes);
  if (bytes.substr(0, kExif.size()) == kExif) bytes.remove_prefix(kExif.size());
  return ParseTiff(bytes);
}

std::optional<ExifTags> ReadExif(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  std::string bytes(kMaxBytes, '\0');
  file.read(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  bytes.resize(static_cast<size_t>(file.gcount()));
  return ParseExif(bytes);
}

double PixelsPerMillimetre(double resolution, double unit) {
  if (unit == 3) return resolution / 10;
  return unit == 2 || unit == 0 ? resolution / 25.4 : 0;
}

std::string MakeExif(const ExifTags& tags) {
  constexpr uint32_t kDivisor = 10000;
  const auto rational = [](Tag tag, double value) {
    return TiffWriter::Entry{tag, kRational,
                             static_cast<uint32_t>(std::lround(std::min(value, 4e5) * kDivisor)), kDivisor};
  };
  std::vector<TiffWriter::Entry> exif;  // by tag
  if (tags.focal_mm > 0) exif.push_back(rational(kFocalLength, tags.focal_mm));
  if (tags.taken[0] > 0 && tags.taken[1] > 0) {
    exif.push_back({kPixelXDimension, kLong, static_cast<uint32_t>(tags.taken[0])});
    exif.push_back({kPixelYDimension, kLong, static_cast<uint32_t>(tags.taken[1])});
  }
  if (tags.plane_px_per_mm > 0) {
    exif.push_back(rational(kFocalPlaneXResolution, 10 * tags.plane_px_per_mm));
    exif.push_back({kFocalPlaneResolutionUnit, kShort, 3});  // centimetres
  }
  if (tags.digital_zoom > 0) exif.push_back(rational(kDigitalZoomRatio, tags.digital_zoom));
  if (tags.focal_35mm_mm > 0) {
    constexpr double kMaxShort = 65535;
    exif.push_back({kFocalLength35mm, kShort,
                    static_cast<uint32_t>(std::lround(std::min(tags.focal_35mm_mm, kMaxShort)))});
  }
  return TiffWriter::Write({{kOrientation, kShort, static_cast<uint32_t>(tags.orientation)}}, exif);
}

bool IsCut(const ExifTags& tags, const ImageSize& size) {
  const auto [width, height] = TakenAsStored(tags, size);
  if (width <= 0 || height <= 0 || size.width > width || size.height > height) return false;
  return std::abs(width * size.height / (height * size.width) - 1) > kMaxShapeError;
}

std::optional<double> FocalPixels(const ExifTags& tags, const ImageSize& size) {
  if (size.width <= 0 || size.height <= 0) return std::nullopt;
  const auto [width, height] = TakenAsStored(tags, size);
  const bool is_cut = IsCut(tags, size);
  if (tags.focal_35mm_mm > 0) {
    const double diagonal = is_cut ? std::hypot(width, height) : std::hypot(size.width, size.height);
    return tags.focal_35mm_mm / kFilmDiagonalMm * diagonal;
  }
  if (tags.focal_mm > 0 && tags.plane_px_per_mm > 0 && width > 0 && height > 0) {
    const double resized = is_cut ? 1 : size.width / width;
    return tags.focal_mm * tags.plane_px_per_mm * resized * std::max(tags.digital_zoom, 1.0);
  }
  return std::nullopt;
}

Image8 TurnUpright(const Image8& image, int orientation) {
  if (orientation <= 1 || orientation > 8) return image;
  const bool swaps = orientation >= 5;
  Image8 turned{swaps ? image.height : image.width, swaps ? image.width : image.height, image.channels, {}};
  turned.pixels.resize(image.pixels.size());
  const int right = image.width - 1;
  const int bottom = image.height - 1;
  for (int y = 0; y < turned.height; ++y) {
    for (int x = 0; x < turned.width; ++x) {
      // TIFF's tag says where the stored rows' and columns' beginnings belong.
      int from_x = swaps ? y : x;
      int from_y = swaps ? x : y;
      if (orientation == 2 || orientation == 3 || orientation == 7 || orientation == 8)
        from_x = right - from_x;
      if (orientation == 3 || orientation == 4 || orientation == 6 || orientation == 7)
        from_y = bottom - from_y;
      std::copy_n(image.Pixel(from_x, from_y), image.channels, turned.Pixel(x, y));
    }
  }
  return turned;
}

Image8 MirrorRows(const Image8& image) { return TurnUpright(image, 2); }

int OrientationOfMirrored(int orientation) {
  S2GS_INVARIANT(IsMirrored(orientation));
  constexpr std::array<int, 9> kTurn = {1, 1, 1, 1, 3, 8, 1, 6, 1};
  return kTurn[static_cast<size_t>(orientation)];
}

int ReadOrientation(const std::filesystem::path& path) {
  const std::optional<ExifTags> tags = ReadExif(path);
  return tags ? tags->orientation : 1;
}

}  // namespace s2gs
