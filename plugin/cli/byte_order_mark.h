#pragma once

#include <string_view>

namespace s2gs {

/// A text without the byte-order mark of UTF-8, which spreadsheets and editors of Windows put before it.
inline std::string_view WithoutByteOrderMark(std::string_view text) {
  constexpr std::string_view kByteOrderMark = "\xEF\xBB\xBF";
  if (text.substr(0, kByteOrderMark.size()) == kByteOrderMark) text.remove_prefix(kByteOrderMark.size());
  return text;
}

}  // namespace s2gs
