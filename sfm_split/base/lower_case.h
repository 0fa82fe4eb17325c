#pragma once

#include <algorithm>
#include <cctype>
#include <filesystem>
#include <string>

namespace s2gs {

/// A to Z as a to z; other bytes, of UTF-8 for example, as they are.
inline std::string LowerCase(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return text;
}

/// ".jpg" of "sub/a.JPG": cameras write either.
inline std::string LowerCaseExtension(const std::filesystem::path& path) {
  return LowerCase(path.extension().string());
}

}  // namespace s2gs
