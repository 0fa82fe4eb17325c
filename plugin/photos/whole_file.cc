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
constexpr size_t kMaxFolders = 32;       // pictures, previews and what belongs to them
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

struct PictureParts {
  uint64_t offsets;  ///< the tags that tell where the parts begin ...
  uint64_t lengths;  ///< ... and how many bytes each has.
};
constexpr std::array<PictureParts, 3> kTiffParts = {
    {{273, 279}, {324, 325}, {513, 514}}};                               // strips, tiles, JPEG
constexpr std::array<PictureParts, 1> kPanasonicParts = {{{280, 279}}};  // 273 is no place there

// Raw files keep their pixels in folders below the first one, or after it (TIFF 6.0, supplement 1; DNG 1.4).
template <size_t kCount>
bool TiffEndsTooEarly(Numbers& file, const std::array<PictureParts, kCount>& parts) {
  constexpr uint64_t kSubFolders = 330;
  std::vector<uint64_t> folders = {file.Get(4, 4)};
  for (size_t f = 0; f < folders.size(); ++f) {
    const uint64_t folder = folders[f];
    if (folder + 2 > file.size()) return true;
    const uint64_t num_entries = file.Get(folder, 2);
    if (folder + 2 + 12 * num_entries > file.size()) return true;
    std::array<std::vector<uint64_t>, kCount> offsets;
    std::array<std::vector<uint64_t>, kCount> lengths;
    std::vector<uint64_t> next;
    for (uint64_t i = 0; i < num_entries; ++i) {
      const uint64_t entry = folder + 2 + 12 * i;
      const uint64_t tag = file.Get(entry, 2);
      // Each stands there once; a file that repeats them would have them read thousands of times.
      for (size_t p = 0; p < kCount; ++p) {
        if (offsets[p].empty() && tag == parts[p].offsets) offsets[p] = TagValues(file, entry);
        if (lengths[p].empty() && tag == parts[p].lengths) lengths[p] = TagValues(file, entry);
      }
      if (next.empty() && tag == kSubFolders) next = TagValues(file, entry);
    }
    for (size_t p = 0; p < kCount; ++p) {
      for (size_t i = 0; i < std::min(offsets[p].size(), lengths[p].size()); ++i) {
        if (offsets[p][i] + lengths[p][i] > file.size()) return true;
      }
    }
    next.push_back(file.Get(folder + 2 + 12 * num_entries, 4));
    for (const uint64_t other : next) {
      const bool is_known = std::find(folders.begin(), folders.end(), other) != folders.end();
      if (other != 0 && !is_known && folders.size() < kMaxFolders) folders.push_back(other);
    }
  }
  return false;
}

// Where Fujifilm's header says that the preview, its tags and the pixels are, each by offset and length.
bool FujifilmEndsTooEarly(Numbers& file) {
  file.SetBigEndian(true);
  for (const uint64_t at : {84U, 92U, 100U}) {
    if (file.Get(at, 4) + file.Get(at + 4, 4) > file.size()) return true;
  }
  return file.size() < 108;
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
  const std::string_view magic = head.substr(0, 4);
  const auto is_one_of = [&](const std::array<std::string_view, 5>& kinds) {
    return std::find(kinds.begin(), kinds.end(), magic) != kinds.end();
  };
  // TIFF in both orders of bytes, and Olympus' raw files, which are laid out alike.
  if (is_one_of({{{"II*\0", 4}, {"MM\0*", 4}, "IIRO", "IIRS", "MMOR"}})) {
    file.SetBigEndian(head[0] == 'M');
    return TiffEndsTooEarly(file, kTiffParts);
  }
  if (magic == std::string_view("IIU\0", 4)) return TiffEndsTooEarly(file, kPanasonicParts);
  if (head == "FUJIFILMCCD-") return FujifilmEndsTooEarly(file);
  if (head.substr(4, 4) == "ftyp") return BoxesEndTooEarly(file);
  if (head.substr(0, 4) == "RIFF") return file.Get(4, 4) + 8 > file.size();
  if (head.substr(0, 2) == "BM") return file.Get(2, 4) > file.size();
  return false;
}

}  // namespace s2gs
