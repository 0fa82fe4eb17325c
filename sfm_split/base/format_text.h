#pragma once

#include <string>

namespace s2gs {

/// Text as std::printf would print it, of at most 255 characters. The compiler compares format and values.
[[gnu::format(printf, 1, 2)]] std::string FormatText(const char* format, ...);

}  // namespace s2gs
