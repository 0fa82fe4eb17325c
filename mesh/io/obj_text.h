#pragma once

#include <Eigen/Core>
#include <array>
#include <charconv>
#include <ostream>
#include <string>
#include <string_view>

#include "sfm_split/base/error.h"

namespace s2gs {

/// Appends a number so that it reads back as the same value, whatever the locale.
template <typename Number>
void AppendNumber(Number value, std::string* text) {
  std::array<char, 32> buffer{};
  const auto [end, error] = std::to_chars(buffer.data(), buffer.data() + buffer.size(), value);
  S2GS_INVARIANT(error == std::errc());
  text->append(buffer.data(), end);
}

/// The keyword and the three numbers, each after a space.
inline void AppendObjVector(std::string_view keyword, const Eigen::Vector3f& vector, std::string* text) {
  *text += keyword;
  for (int i = 0; i < 3; ++i) {
    *text += ' ';
    AppendNumber(vector[i], text);
  }
}

/// Text that is handed on to a stream now and then.
class ObjText {
 public:
  explicit ObjText(std::ostream& stream) : stream_(stream) {}
  std::string& text() { return text_; }
  void EndLine() {
    text_ += '\n';
    if (text_.size() < kChunk) return;
    Flush();
  }
  void Flush() {
    stream_.write(text_.data(), static_cast<std::streamsize>(text_.size()));
    text_.clear();
  }

 private:
  static constexpr size_t kChunk = 1 << 16;
  std::ostream& stream_;
  std::string text_;
};

}  // namespace s2gs
