#include "sfm_split/base/printable.h"

#include <array>
#include <cstdint>

namespace s2gs {
namespace {

// The lead byte's bits that say how many bytes there are, and the smallest character that needs so many.
struct Utf8Form {
  uint8_t mask;
  uint8_t value;
  char32_t smallest;
};
// By how many bytes follow the first.
constexpr std::array<Utf8Form, 4> kForms = {
    {{0x80, 0x00, 0x0}, {0xE0, 0xC0, 0x80}, {0xF0, 0xE0, 0x800}, {0xF8, 0xF0, 0x10000}}};
constexpr char32_t kLargest = 0x10FFFF;  // of Unicode

}  // namespace

std::optional<Utf8Character> FirstCharacter(std::string_view text) {
  if (text.empty()) return std::nullopt;
  const auto lead = static_cast<uint8_t>(text[0]);
  for (size_t extra = 0; extra < kForms.size(); ++extra) {
    const Utf8Form& form = kForms[extra];
    if ((lead & form.mask) != form.value) continue;
    if (text.size() <= extra) return std::nullopt;
    char32_t code = lead & static_cast<uint8_t>(~form.mask);
    for (size_t i = 1; i <= extra; ++i) {
      const auto byte = static_cast<uint8_t>(text[i]);
      if ((byte & 0xC0U) != 0x80U) return std::nullopt;
      code = (code << 6U) | (byte & 0x3FU);
    }
    const bool is_surrogate = code >= 0xD800 && code <= 0xDFFF;
    if (code < form.smallest || code > kLargest || is_surrogate) return std::nullopt;
    return Utf8Character{code, extra + 1};
  }
  return std::nullopt;
}

bool IsControl(char32_t code) { return code < 0x20 || (code >= 0x7F && code <= 0x9F); }

std::string Printable(std::string_view text) {
  constexpr char kDigits[] = "0123456789abcdef";  // of a byte that is no character
  std::string shown;
  shown.reserve(text.size());
  while (!text.empty()) {
    const std::optional<Utf8Character> character = FirstCharacter(text);
    const size_t num_bytes = character ? character->num_bytes : 1;
    const bool is_layout = text[0] == '\n' || text[0] == '\t';
    if (character && (is_layout || !IsControl(character->code))) {
      shown += text.substr(0, num_bytes);
    } else {
      for (const char c : text.substr(0, num_bytes)) {
        const auto byte = static_cast<uint8_t>(c);
        shown += "\\x";
        shown += kDigits[byte >> 4U];
        shown += kDigits[byte & 0xFU];
      }
    }
    text.remove_prefix(num_bytes);
  }
  return shown;
}

}  // namespace s2gs
