#include "sfm_split/base/byte_reader.h"

#include <limits>
#include <utility>

namespace s2gs {

static_assert(std::numeric_limits<double>::is_iec559, "the file formats store IEEE 754 numbers");
static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "the file formats are little-endian");

uint64_t RemainingBytes(std::istream& stream, const std::filesystem::path& path) {
  const std::istream::pos_type begin = stream.tellg();
  stream.seekg(0, std::ios::end);
  const std::istream::pos_type end = stream.tellg();
  stream.seekg(begin);
  if (!stream || begin < 0 || end < begin) {
    throw UserError(path, "cannot find out its size", "Only regular files can be read, not pipes or devices");
  }
  return static_cast<uint64_t>(end - begin);
}

ByteReader::ByteReader(std::istream& stream, std::filesystem::path path)
    : stream_(stream), path_(std::move(path)), size_(RemainingBytes(stream, path_)) {}

void ByteReader::ReadBytes(void* target, uint64_t count, const char* what) {
  if (count > remaining()) {
    Fail("the file ends inside " + std::string(what) + " (" + std::to_string(count) + " bytes wanted, " +
         std::to_string(remaining()) + " left)");
  }
  stream_.read(static_cast<char*>(target), static_cast<std::streamsize>(count));
  if (!stream_) Fail("cannot read " + std::string(what));
  offset_ += count;
}

uint64_t ByteReader::ReadCount(uint64_t min_item_bytes, const char* what) {
  const auto count = Read<uint64_t>(what);
  CheckCount(count, min_item_bytes, what);
  return count;
}

void ByteReader::CheckCount(uint64_t count, uint64_t min_item_bytes, const char* what) const {
  S2GS_INVARIANT(min_item_bytes > 0);
  if (count > remaining() / min_item_bytes) {
    Fail(std::string(what) + " is " + std::to_string(count) + ", but the " + std::to_string(remaining()) +
         " bytes left can hold no more than " + std::to_string(remaining() / min_item_bytes));
  }
}

std::string ByteReader::ReadCString(uint64_t max_length, const char* what) {
  std::string text;
  while (true) {
    const char c = Read<char>(what);
    if (c == '\0') return text;
    if (text.size() >= max_length) {
      Fail(std::string(what) + " is longer than " + std::to_string(max_length) + " characters");
    }
    text.push_back(c);
  }
}

void ByteReader::Fail(const std::string& problem) const {
  throw UserError(
      path_, problem + ", at byte " + std::to_string(offset_),
      "The file is damaged or of another kind: restore it, or run the stage that writes it again");
}

void ByteReader::ExpectEnd() const {
  if (remaining() > 0) Fail(std::to_string(remaining()) + " bytes follow after the end of the content");
}

}  // namespace s2gs
