#pragma once

#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <optional>
#include <stdexcept>
#include <string>

namespace s2gs {

/// A fault that the user can mend: a missing or damaged file, an impossible option, no space left.
/// Thrown anywhere, caught once in main, which prints what() and exits with code 1. The message names the
/// path, says what is wrong, and what to do about it.
class UserError : public std::runtime_error {
 public:
  explicit UserError(const std::string& message) : std::runtime_error(message) {}

  /// \param path     the file or folder at fault, printed first.
  /// \param problem  what is wrong, e.g. "ends at byte 40, inside camera 3".
  /// \param remedy   what the user can do about it; may be empty.
  UserError(const std::filesystem::path& path, const std::string& problem, const std::string& remedy)
      : std::runtime_error(path.string() + ": " + problem + (remedy.empty() ? "" : ". " + remedy)) {}
};

/// Thrown out of a long computation when the user asked it to stop (Ctrl-C). Everything that was finished
/// before is on disk; the same command resumes there.
class Interrupted : public std::runtime_error {
 public:
  Interrupted() : std::runtime_error("interrupted") {}
};

/// One option outside its bounds, as found by an options struct's `Check()`.
struct OptionFault {
  std::string field;  ///< the field's name without its group, e.g. "max_ratio".
  std::string value;  ///< the value as given.
  std::string bound;  ///< the bound that it violates, e.g. "0 < max_ratio <= 1".
};

/// What `Check()` of an options struct returns: nothing when every field is within its bounds.
using OptionCheck = std::optional<OptionFault>;

[[noreturn]] inline void BrokenInvariant(const char* condition, const char* file, int line) {
  std::fprintf(stderr, "s2gs: broken invariant at %s:%d: %s. This is a defect in s2gs: please report it.\n",
               file, line, condition);
  std::abort();
}

}  // namespace s2gs

/// Aborts, in every build type, when a condition that only a defect in s2gs can violate does not hold.
/// Never for input: input that cannot be used throws UserError.
#define S2GS_INVARIANT(condition) \
  ((condition) ? static_cast<void>(0) : ::s2gs::BrokenInvariant(#condition, __FILE__, __LINE__))
