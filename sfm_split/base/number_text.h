#pragma once

#include <array>
#include <charconv>
#include <string>

namespace s2gs {

/// The shortest text that reads back as the same number: "0.5", "1e-09", "inf".
inline std::string NumberText(double value) {
  std::array<char, 32> text;
  const auto end = std::to_chars(text.data(), text.data() + text.size(), value).ptr;
  return {text.data(), end};
}

}  // namespace s2gs
