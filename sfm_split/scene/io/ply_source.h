#pragma once

#include <cstdint>
#include <filesystem>
#include <istream>
#include <string>
#include <string_view>
#include <vector>

#include "sfm_split/base/byte_reader.h"

namespace s2gs {

/// The bytes of a PLY file, in blocks: lines for its text, runs of bytes for its binary part.
class PlySource {
 public:
  /// The stream must outlive the source. \param path  for messages only.
  PlySource(std::istream& stream, const std::filesystem::path& path) : reader_(stream, path) {}

  /// Bytes from the file's begin to the next one to be taken.
  uint64_t offset() const { return reader_.offset() - buffered(); }
  uint64_t remaining() const { return reader_.remaining() + buffered(); }

  /// The next `count` bytes, in one piece, valid until the next call. Throws when fewer remain.
  const char* Take(uint64_t count, const std::string& what);

  /// The next line without its LF or CRLF, valid until the next call; at the end of the file, what is left.
  /// Throws when it is longer than `max_length`.
  std::string_view TakeLine(uint64_t max_length);

  /// Throw a UserError that says where in the file the problem is.
  [[noreturn]] void FailAtByte(const std::string& problem) const;
  [[noreturn]] void FailAtLine(const std::string& problem) const;  ///< the line last taken.

 private:
  uint64_t buffered() const { return buffer_.size() - begin_; }
  /// Reads on until at least `count` bytes are buffered or the file ends.
  void Fill(uint64_t count);

  ByteReader reader_;
  std::vector<char> buffer_;  ///< bytes [begin_, size) are read but not taken.
  size_t begin_ = 0;
  uint64_t line_ = 0;
};

}  // namespace s2gs
