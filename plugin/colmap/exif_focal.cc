#include "plugin/colmap/exif_focal.h"

#include <cstddef>
#include <cstdint>
#include <fstream>
#include <string>

namespace s2gs {
namespace {

constexpr size_t kMaxBytes = size_t{1} << 17;  // EXIF comes first and is 64 kB at most
constexpr int kMaxEntries = 1000;

enum Tag : uint16_t { kExifFolder = 0x8769, kFocalLength = 0x920A, kFocalLength35mm = 0xA405 };
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

}  // namespace

std::optional<ExifFocal> ParseExifFocal(std::string_view jpeg) {
  const auto byte = [&](size_t i) { return static_cast<uint8_t>(jpeg[i]); };
  if (jpeg.size() < 4 || byte(0) != 0xFF || byte(1) != 0xD8) return std::nullopt;
  for (size_t at = 2; at + 4 <= jpeg.size() && byte(at) == 0xFF;) {
    const uint8_t marker = byte(at + 1);
    if (marker == 0xDA || marker == 0xD9) break;  // the pixels begin
    const size_t length = (size_t{byte(at + 2)} << 8U) | byte(at + 3);
    if (length < 2) break;
    const std::string_view segment = jpeg.substr(at + 4, length - 2);
    constexpr std::string_view kExif("Exif\0\0", 6);
    if (marker == 0xE1 && segment.substr(0, kExif.size()) == kExif) {
      const Tiff tiff(segment.substr(kExif.size()));
      if (!tiff.IsValid()) return std::nullopt;
      const size_t folder_entry = tiff.Find(tiff.Read(4, 4), kExifFolder);
      if (folder_entry == 0) return std::nullopt;
      const size_t folder = tiff.Read(folder_entry + 8, 4);
      const ExifFocal focal{tiff.Number(tiff.Find(folder, kFocalLength)),
                            tiff.Number(tiff.Find(folder, kFocalLength35mm))};
      if (focal == ExifFocal()) return std::nullopt;
      return focal;
    }
    at += 2 + length;
  }
  return std::nullopt;
}

std::optional<ExifFocal> ReadExifFocal(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  std::string bytes(kMaxBytes, '\0');
  file.read(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  bytes.resize(static_cast<size_t>(file.gcount()));
  return ParseExifFocal(bytes);
}

}  // namespace s2gs
