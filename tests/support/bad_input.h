#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <initializer_list>
#include <string>

namespace s2gs {

/// Calls `check` with every truncation of `bytes` (0 to size - 1 bytes kept) and with every copy of `bytes`
/// in which a single bit is flipped: 9 calls a byte, so keep `bytes` to a few hundred.
/// \param check  gets the damaged content and what was done to it, e.g. "cut to 17 bytes".
void ForEachDamage(
    const std::string& bytes,
    const std::function<void(const std::string& damaged, const std::string& description)>& check);

/// `bytes` with the `size` bytes at `offset` replaced by the little-endian `value` (size 1 to 8).
std::string WithInteger(std::string bytes, size_t offset, size_t size, uint64_t value);

/// Fails the current test unless `read` returns, or throws UserError with `path_substring` in its message.
/// \param description  of the input, added to the failure's message.
/// \return  whether `read` returned.
bool ExpectOkOrUserError(const std::function<void()>& read, const std::string& path_substring,
                         const std::string& description = "");

/// Fails the current test unless `read` throws UserError whose message has every one of `substrings`.
void ExpectUserError(const std::function<void()>& read, std::initializer_list<std::string> substrings,
                     const std::string& description = "");

/// While one exists, `operator new` on this thread throws std::bad_alloc for any single request of more than
/// `bytes`, and the current test fails. Allocations that bypass operator new (malloc, Eigen's dynamic
/// matrices) are not seen. Limits nest; the inner one holds.
class ScopedAllocationLimit {
 public:
  explicit ScopedAllocationLimit(size_t bytes);
  ScopedAllocationLimit(const ScopedAllocationLimit&) = delete;
  ScopedAllocationLimit& operator=(const ScopedAllocationLimit&) = delete;
  ~ScopedAllocationLimit();

  /// The largest single request since the limit began, refused ones included.
  static size_t LargestRequest();

 private:
  size_t limit_;
  size_t outer_limit_;
  size_t outer_largest_;
};

}  // namespace s2gs
