#include "tests/support/dng_file.h"

#include <cmath>
#include <cstddef>
#include <fstream>
#include <string>
#include <vector>

namespace s2gs {
namespace {

constexpr size_t kHeaderBytes = 8;
constexpr size_t kEntryBytes = 12;

// A tag's type in TIFF and its bytes.
enum Type : uint16_t { kByte = 1, kAscii = 2, kShort = 3, kLong = 4, kRational = 5, kSignedRational = 10 };

void Put(std::string* bytes, uint64_t value, size_t count) {
  for (size_t i = 0; i < count; ++i) bytes->push_back(static_cast<char>((value >> (8 * i)) & 255U));
}

// One folder of tags: entries, then the values that do not fit into them.
class TagFolder {
 public:
  void Add(uint16_t tag, Type type, const std::vector<uint32_t>& values) {
    const bool is_fraction = type == kRational || type == kSignedRational;
    const size_t bytes = type == kByte || type == kAscii ? 1 : type == kShort ? 2 : 4;
    std::string data;
    for (const uint32_t value : values) Put(&data, value, bytes);
    tags_.push_back({tag, type, static_cast<uint32_t>(values.size() / (is_fraction ? 2 : 1)), data});
  }
  void Add(uint16_t tag, const std::string& text) {
    std::vector<uint32_t> values(text.begin(), text.end());
    values.push_back(0);
    Add(tag, kAscii, values);
  }
  size_t NumBytes() const {
    size_t bytes = 2 + kEntryBytes * tags_.size() + 4;
    for (const Tag& tag : tags_) bytes += tag.data.size() > 4 ? tag.data.size() : 0;
    return bytes;
  }
  std::string At(size_t begin) const {
    std::string entries;
    std::string values;
    Put(&entries, tags_.size(), 2);
    for (const Tag& tag : tags_) {
      Put(&entries, tag.id, 2);
      Put(&entries, tag.type, 2);
      Put(&entries, tag.count, 4);
      if (tag.data.size() <= 4) {
        entries += tag.data + std::string(4 - tag.data.size(), '\0');
      } else {
        Put(&entries, begin + 2 + kEntryBytes * tags_.size() + 4 + values.size(), 4);
        values += tag.data;
      }
    }
    Put(&entries, 0, 4);  // no other folder
    return entries + values;
  }

 private:
  struct Tag {
    uint16_t id;
    uint16_t type;
    uint32_t count;
    std::string data;
  };
  std::vector<Tag> tags_;
};

std::string Mosaic(const DngPhoto& photo) {
  std::string bytes;
  for (int y = 0; y < photo.height; ++y) {
    for (int x = 0; x < photo.width; ++x) {
      const int channel = y % 2 + x % 2;  // red, green, green, blue
      Put(&bytes, static_cast<uint64_t>(std::lround(65535 * photo.light(x, y)[channel])), 2);
    }
  }
  return bytes;
}

// The tags in ascending order; the mosaic and the folder of EXIF stand at these places.
TagFolder Tags(const DngPhoto& photo, size_t mosaic, size_t exif) {
  // From XYZ to the camera's colours, which are those of sRGB, in units of 1e-4 (IEC 61966-2-1).
  constexpr std::array<int, 9> kFromXyz = {32405, -15371, -4985, -9693, 18760, 416, 556, -2040, 10572};
  const auto width = static_cast<uint32_t>(photo.width);
  const auto height = static_cast<uint32_t>(photo.height);
  TagFolder tags;
  tags.Add(254, kLong, {0});  // the picture itself
  tags.Add(256, kLong, {width});
  tags.Add(257, kLong, {height});
  tags.Add(258, kShort, {16});     // bits
  tags.Add(259, kShort, {1});      // not compressed
  tags.Add(262, kShort, {32803});  // a mosaic of colour filters
  tags.Add(271, "Test");           // who made the camera
  tags.Add(272, "Bayer");
  tags.Add(273, kLong, {static_cast<uint32_t>(mosaic)});
  tags.Add(274, kShort, {static_cast<uint32_t>(photo.orientation)});
  tags.Add(277, kShort, {1});      // one sample for each pixel
  tags.Add(278, kLong, {height});  // all rows in one strip
  tags.Add(279, kLong, {2 * width * height});
  tags.Add(33421, kShort, {2, 2});  // filters repeat every 2 by 2 pixels
  tags.Add(33422, kByte, {0, 1, 1, 2});
  tags.Add(34665, kLong, {static_cast<uint32_t>(exif)});
  tags.Add(50706, kByte, {1, 4, 0, 0});  // DNG's version
  tags.Add(50708, "Test Bayer");
  tags.Add(50714, kLong, {0});      // black
  tags.Add(50717, kLong, {65535});  // white
  if (photo.crop[2] > 0) {
    tags.Add(50719, kLong, {static_cast<uint32_t>(photo.crop[0]), static_cast<uint32_t>(photo.crop[1])});
    tags.Add(50720, kLong, {static_cast<uint32_t>(photo.crop[2]), static_cast<uint32_t>(photo.crop[3])});
  }
  std::vector<uint32_t> matrix;
  for (const int value : kFromXyz) {
    matrix.push_back(static_cast<uint32_t>(value));
    matrix.push_back(10000);
  }
  tags.Add(50721, kSignedRational, matrix);
  tags.Add(50728, kRational, {1, 1, 1, 1, 1, 1});  // neutral as shot
  tags.Add(50778, kShort, {21});                   // daylight of 6500 K
  return tags;
}

}  // namespace

void WriteDng(const std::filesystem::path& path, const DngPhoto& photo) {
  TagFolder exif;
  exif.Add(37386, kRational, {static_cast<uint32_t>(std::lround(1000 * photo.focal_mm)), 1000});
  const size_t exif_at = kHeaderBytes + Tags(photo, 0, 0).NumBytes();
  const size_t mosaic_at = exif_at + exif.NumBytes();
  std::string bytes = "II*";
  Put(&bytes, 0, 1);
  Put(&bytes, kHeaderBytes, 4);
  bytes += Tags(photo, mosaic_at, exif_at).At(kHeaderBytes) + exif.At(exif_at) + Mosaic(photo);
  std::ofstream(path, std::ios::binary) << bytes;
}

}  // namespace s2gs
