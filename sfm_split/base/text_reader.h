#pragma once

#include <cstdint>
#include <filesystem>
#include <istream>
#include <string>
#include <string_view>
#include <system_error>

#include "sfm_split/base/error.h"
#include "sfm_split/base/parse_number.h"

namespace s2gs {

/// Reads a text file of lines of numbers and words whose content cannot be trusted. Numbers are read in full
/// (trailing characters and values out of range are faults) and do not depend on the locale.
/// All faults are thrown as UserError with the path and the line's number.
class TextReader {
 public:
  /// \param stream  read from its current position; must outlive the reader.
  /// \param path    for messages only; may be a description such as "memory".
  TextReader(std::istream& stream, std::filesystem::path path);

  /// Goes to the next line. \return  false at the end of the file.
  bool NextLine();

  /// Goes to the next line that is neither blank nor a comment (first character '#').
  bool NextDataLine();

  /// Whether the current line ended with a line break, not with the file.
  bool has_line_break() const { return has_line_break_; }

  /// Whether the current line has no further word.
  bool AtLineEnd();

  /// The next word of the current line; words are separated by spaces and tabs.
  /// \param what  names it in messages, e.g. "camera id".
  std::string_view Word(const char* what);

  /// The rest of the current line without the spaces around it.
  std::string_view Rest();

  /// The next word as a number.
  template <typename T>
  T Number(const char* what) {
    const std::string_view word = Word(what);
    T value{};
    if (ParseNumber(word, &value) != std::errc()) FailNumber(what, word);
    return value;
  }

  /// Throws unless the current line is used up.
  void ExpectLineEnd();

  /// Throws a UserError that says in which line the problem is.
  [[noreturn]] void Fail(const std::string& problem) const;

 private:
  [[noreturn]] void FailNumber(const char* what, std::string_view word) const;

  std::istream& stream_;
  std::filesystem::path path_;
  std::string line_;
  size_t position_ = 0;
  uint64_t line_number_ = 0;
  bool has_line_break_ = false;
};

/// Appends a number so that reading it back gives the same bits, with at most 17 significant digits, as C's
/// "%.17g" prints it in every locale.
void AppendNumber(double value, std::string* text);

}  // namespace s2gs
