#include "sfm_split/base/format_text.h"

#include <cstdarg>
#include <cstdio>

namespace s2gs {

std::string FormatText(const char* format, ...) {
  char text[256];
  std::va_list values;
  va_start(values, format);
  std::vsnprintf(text, sizeof(text), format, values);
  va_end(values);
  return text;
}

}  // namespace s2gs
