#pragma once

#include <cstdio>
#include <string>

namespace s2gs {

/// Text as std::printf would print it, of at most 255 characters.
template <class... Values>
std::string FormatText(const char* format, Values... values) {
  char text[256];
  std::snprintf(text, sizeof(text), format, values...);
  return text;
}

}  // namespace s2gs
