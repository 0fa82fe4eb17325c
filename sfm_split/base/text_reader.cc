#include "sfm_split/base/text_reader.h"

#include <algorithm>
#include <array>
#include <utility>

namespace s2gs {
namespace {

constexpr std::string_view kSpaces = " \t\r";  // between words; \r where lines end as on Windows

// What a message can show of a word from a damaged file.
std::string Printable(std::string_view word) {
  constexpr size_t kMaxLength = 40;  // characters of a word in a message
  std::string text;
  for (const char c : word.substr(0, kMaxLength)) text += c >= ' ' && c <= '~' ? c : '?';
  return word.size() > kMaxLength ? text + "..." : text;
}

}  // namespace

TextReader::TextReader(std::istream& stream, std::filesystem::path path)
    : stream_(stream), path_(std::move(path)) {}

bool TextReader::NextLine() {
  position_ = 0;
  if (!std::getline(stream_, line_)) {
    line_.clear();
    if (stream_.bad()) Fail("cannot be read");
    return false;
  }
  has_line_break_ = !stream_.eof();
  ++line_number_;
  return true;
}

bool TextReader::NextDataLine() {
  while (NextLine()) {
    if (!AtLineEnd() && line_[position_] != '#') return true;
  }
  return false;
}

bool TextReader::AtLineEnd() {
  position_ = std::min(line_.find_first_not_of(kSpaces, position_), line_.size());
  return position_ == line_.size();
}

std::string_view TextReader::Word(const char* what) {
  if (AtLineEnd()) Fail(std::string(what) + " is missing");
  const size_t begin = position_;
  position_ = std::min(line_.find_first_of(kSpaces, begin), line_.size());
  return std::string_view(line_).substr(begin, position_ - begin);
}

std::string_view TextReader::Rest() {
  AtLineEnd();
  const size_t begin = position_;
  position_ = line_.size();
  const std::string_view rest = std::string_view(line_).substr(begin);
  return rest.substr(0, rest.find_last_not_of(kSpaces) + 1);
}

void TextReader::ExpectLineEnd() {
  if (!AtLineEnd()) Fail("unexpected \"" + Printable(Word("word")) + "\"");
}

void TextReader::Fail(const std::string& problem) const {
  throw UserError(
      path_, problem + ", in line " + std::to_string(line_number_),
      "The file is damaged or of another kind: restore it, or run the stage that writes it again");
}

void TextReader::FailNumber(const char* what, std::string_view word) const {
  Fail(std::string(what) + " is \"" + Printable(word) + "\", which is no number that fits there");
}

void AppendNumber(double value, std::string* text) {
  std::array<char, 40> buffer{};
  const auto result =
      std::to_chars(buffer.data(), buffer.data() + buffer.size(), value, std::chars_format::general, 17);
  S2GS_INVARIANT(result.ec == std::errc());
  text->append(buffer.data(), result.ptr);
}

}  // namespace s2gs
