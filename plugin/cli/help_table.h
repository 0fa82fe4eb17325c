#pragma once

#include <cstddef>
#include <string>
#include <utility>
#include <vector>

namespace s2gs {

/// Most characters of a line of help.
constexpr size_t kHelpWidth = 110;

/// Text in lines of at most `width` characters, broken at spaces.
std::vector<std::string> Wrapped(const std::string& text, size_t width);

/// One line of an option table.
struct HelpRow {
  std::string option;  ///< "--name KIND"
  std::string value;   ///< the default
  std::string unit;
  std::string meaning;
};

/// Options in columns, whose widths all parts of a table share; meanings are wrapped to kHelpWidth.
class HelpTable {
 public:
  void Add(HelpRow row) { lines_.push_back({std::move(row), ""}); }
  /// A blank line and, where it is not empty, a title before the rows that follow.
  void BeginPart(std::string title) { lines_.push_back({{}, std::move(title)}); }

  /// Begins with the columns' names. Ends with a newline.
  std::string Text() const;

 private:
  struct Line {
    HelpRow row;  // without an option where a part begins
    std::string title;
  };

  std::vector<Line> lines_;
};

}  // namespace s2gs
