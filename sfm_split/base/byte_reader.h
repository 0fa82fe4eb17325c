#pragma once

#include <cstdint>
#include <filesystem>
#include <istream>
#include <string>
#include <type_traits>
#include <vector>

#include "sfm_split/base/error.h"

namespace s2gs {

/// Reads a little-endian binary file whose content cannot be trusted. Every read is checked against the size
/// that the stream really has, and every count against what the remaining bytes can hold, so that no lie in
/// a file makes the program read past the end or allocate more than a small multiple of the file's size.
/// All faults are thrown as UserError with the path and the byte offset.
class ByteReader {
 public:
  /// \param stream  a seekable binary stream, read from its current position; must outlive the reader.
  /// \param path    for messages only; may be a description such as "memory".
  ByteReader(std::istream& stream, std::filesystem::path path);

  /// Offset of the next byte from where the reader started.
  uint64_t offset() const { return offset_; }
  uint64_t remaining() const { return size_ - offset_; }
  const std::filesystem::path& path() const { return path_; }

  /// One number. `what` names it in the message, e.g. "camera id".
  template <typename T>
  T Read(const char* what) {
    static_assert(kIsReadable<T>, "structs have padding, and not every byte is a bool: read their bytes");
    T value{};
    ReadBytes(&value, sizeof(T), what);
    return value;
  }

  /// `count` values; the count is checked against the remaining bytes before anything is allocated.
  template <typename T>
  std::vector<T> ReadVector(uint64_t count, const char* what) {
    static_assert(kIsReadable<T>, "structs have padding, and not every byte is a bool: read their bytes");
    CheckCount(count, sizeof(T), what);
    std::vector<T> values(count);
    if (count > 0) ReadBytes(values.data(), count * sizeof(T), what);
    return values;
  }

  void ReadBytes(void* target, uint64_t count, const char* what);

  /// Reads a 64-bit count and checks that as many items of at least `min_item_bytes` each still fit.
  uint64_t ReadCount(uint64_t min_item_bytes, const char* what);

  /// Throws unless `count` items of at least `min_item_bytes` each fit into the remaining bytes.
  void CheckCount(uint64_t count, uint64_t min_item_bytes, const char* what) const;

  /// A string that ends at the first zero byte, which is consumed.
  std::string ReadCString(uint64_t max_length, const char* what);

  /// Throws a UserError that says where in the file the problem is.
  [[noreturn]] void Fail(const std::string& problem) const;

  /// Throws unless every byte was consumed.
  void ExpectEnd() const;

 private:
  template <typename T>
  // Every pattern of its bytes is a value.
  static constexpr bool kIsReadable = std::is_arithmetic_v<T> && !std::is_same_v<T, bool>;

  std::istream& stream_;
  std::filesystem::path path_;
  uint64_t size_ = 0;
  uint64_t offset_ = 0;
};

/// The bytes between a stream's current position and its end; the position is kept.
/// Throws UserError when the stream cannot seek.
uint64_t RemainingBytes(std::istream& stream, const std::filesystem::path& path);

}  // namespace s2gs
