#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <string_view>

namespace s2gs {

/// A character of UTF-8 text.
struct Utf8Character {
  char32_t code = 0;
  size_t num_bytes = 0;
};

/// The character at the front of `text`; nothing when its bytes are no UTF-8 (RFC 3629: no overlong forms, no
/// surrogates, nothing above U+10FFFF) or there are none.
std::optional<Utf8Character> FirstCharacter(std::string_view text);

/// Whether a terminal may take it for a command: C0, DEL and C1.
bool IsControl(char32_t code);

/// Text from elsewhere as it may be shown on a terminal: control characters but line feed and tab, and bytes
/// that are no UTF-8, become \xNN.
std::string Printable(std::string_view text);

}  // namespace s2gs
