#include "plugin/photos/whole_file.h"

#include <algorithm>
#include <array>
#include <cstdint>
#include <fstream>
#include <string_view>
#include <utility>
#include <vector>

#include "sfm_split/base/byte_reader.h"
#include "sfm_split/base/file_io.h"

namespace s2gs {
namespace {

constexpr uint32_t kMaxParts = 1 << 20;  // strips or tiles of a picture
constexpr int kMaxBoxes = 10000;

// Numbers of a file at any place; 0 beyond its end.
class Numbers {
 public:
  explicit Numbers(const std::filesystem::path& path) : stream_(OpenForReading(path)) {
    size_ = RemainingBytes(stream_, path);
  }
  uint64_t size() const { return size_; }
  void SetBigEndian(bool is_big_endian) { is_big_endian_ = is_big_endian; }

  std::string Text(uint64_t at, size_t count) {
    std::string text(count, '\0');
    stream_.clear();
    stream_.seekg(static_cast<std::streamoff>(at));
    stream_.read(text.data(), static_cast<std::streamsize>(count));
    return text;
  }
  uint64_t Get(uint64_t at, size_t count) {
    return at > size_ || size_ - at < count ? 0 : Value(Text(at, count));
  }
  // Of bytes of the file.
  uint64_t Value(std::string_view bytes) const {
    uint64_t value = 0;
    for (size_t i = 0; i < bytes.size(); ++i) {
      value = (value << 8U) | static_cast<uint8_t>(bytes[is_big_endian_ ? i : bytes.size() - 1 - i]);
    }
    return value;
  }

 private:
  std::ifstream stream_;
  uint64_t size_ = 0;
  bool is_big_endian_ = false;
};

// The numbers of a tag: short or long, in the entry itself where they fit.
std::vector<uint64_t> TagValues(Numbers& file, uint64_t entry) {
  const uint64_t type = file.Get(entry + 2, 2);
  const uint64_t count = file.Get(entry + 4, 4);
  if ((type != 3 && type != 4) || count > kMaxParts) return {};
  const size_t bytes = type == 3 ? 2 : 4;
  const uint64_t begin = count * bytes <= 4 ? entry + 8 : file.Get(entry + 8, 4);
  std::vector<uint64_t> values;
  values.reserve(count);
  const std::string block = file.Text(begin, count * bytes);
  for (uint64_t i = 0; i < count; ++i) {
    values.push_back(file.Value(std::string_view(block).substr(i * bytes, bytes)));
  }
  return values;
}

bool TiffEndsTooEarly(Numbers& file) {
  constexpr uint64_t kStripOffsets = 273;
  constexpr uint64_t kStripBytes = 279;
  constexpr uint64_t kTileOffsets = 324;
  constexpr uint64_t kTileBytes = 325;
  const uint64_t folder = file.Get(4, 4);
  if (folder + 2 > file.size()) return true;
  const uint64_t num_entries = file.Get(folder, 2);
  if (folder + 2 + 12 * num_entries > file.size()) return true;
  std::vector<uint64_t> offsets;
  std::vector<uint64_t> lengths;
  for (uint64_t i = 0; i < num_entries; ++i) {
    const uint64_t entry = folder + 2 + 12 * i;
    const uint64_t tag = file.Get(entry, 2);
    // Each stands there once; a file that repeats them would have them read thousands of times.
    if (offsets.empty() && (tag == kStripOffsets || tag == kTileOffsets)) offsets = TagValues(file, entry);
    if (lengths.empty() && (tag == kStripBytes || tag == kTileBytes)) lengths = TagValues(file, entry);
  }
  for (size_t i = 0; i < std::min(offsets.size(), lengths.size()); ++i) {
    if (offsets[i] + lengths[i] > file.size()) return true;
  }
  return false;
}

bool BoxesEndTooEarly(Numbers& file) {
  file.SetBigEndian(true);
  uint64_t at = 0;
  for (int i = 0; i < kMaxBoxes && at < file.size(); ++i) {
    if (file.size() - at < 8) return true;
    uint64_t length = file.Get(at, 4);
    if (length == 0) return false;  // up to the end
    if (length == 1) length = file.Get(at + 8, 8);
    if (length < 8 || length > file.size() - at) return true;
    at += length;
  }
  return false;
}

}  // namespace

bool EndsTooEarly(const std::filesystem::path& path) {
  Numbers file(path);
  const std::string begin = file.Text(0, 12);
  const std::string_view head = begin;
  constexpr std::string_view kLittleTiff("II*\0", 4);
  constexpr std::string_view kBigTiff("MM\0*", 4);
  if (head.substr(0, 4) == kLittleTiff || head.substr(0, 4) == kBigTiff) {
    file.SetBigEndian(head[0] == 'M');
    return TiffEndsTooEarly(file);
  }
  if (head.substr(4, 4) == "ftyp") return BoxesEndTooEarly(file);
  if (head.substr(0, 4) == "RIFF") return file.Get(4, 4) + 8 > file.size();
  if (head.substr(0, 2) == "BM") return file.Get(2, 4) > file.size();
  return false;
}

}  // namespace s2gs
