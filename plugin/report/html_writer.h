#pragma once

#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace s2gs {

/// Text as it may stand between tags and inside quoted attributes: the five characters that mean something
/// there become entities, control characters but tab and line break, and bytes that are not UTF-8, U+FFFD.
/// Names of photos are whatever somebody called their files.
std::string EscapeHtml(std::string_view text);

/// A number for SVG and for people, with at most `digits` digits after the point and no zeros at the end;
/// "–" where it is not finite.
std::string ShortNumber(double value, int digits = 2);

/// A number with `digits` significant ones, "–" where it is not finite.
std::string Significant(double value, int digits = 3);

/// Attributes of an element, name and value; values are escaped.
using HtmlAttributes = std::vector<std::pair<std::string_view, std::string>>;

/// Builds HTML or SVG in memory. Whatever is handed in as text or value of an attribute is escaped; tags and
/// the names of attributes are the program's own.
class HtmlWriter {
 public:
  HtmlWriter& Open(std::string_view tag, const HtmlAttributes& attributes = {});
  /// Closes the element that was opened last.
  HtmlWriter& Close();
  HtmlWriter& Text(std::string_view text);
  /// An element with nothing but text in it.
  HtmlWriter& Element(std::string_view tag, std::string_view text, const HtmlAttributes& attributes = {});
  /// An element without content: img, input, and all that SVG draws with.
  HtmlWriter& Void(std::string_view tag, const HtmlAttributes& attributes = {});
  /// What is HTML already.
  HtmlWriter& Append(const std::string& html);

  /// All elements must be closed.
  const std::string& html() const;

 private:
  void Start(std::string_view tag, const HtmlAttributes& attributes);

  std::string html_;
  std::vector<std::string> open_;
};

/// A table's row of cells; numbers stand at the right.
void WriteRow(const std::vector<std::string>& cells, HtmlWriter* out, std::string_view tag = "td");
/// A row whose cells know their heads, for tables of class "stacked": on a phone their cells stand below each
/// other, each with its head before it.
void WriteHeadedRow(const std::vector<std::string>& head, const std::vector<std::string>& cells,
                    HtmlWriter* out);

/// Key figures beside each other: what, value, and what to know about it.
struct Tile {
  std::string what;
  std::string value;
  std::string note;
};
void WriteTiles(const std::vector<Tile>& tiles, HtmlWriter* out);

/// A paragraph that says why something is not shown.
void WriteMissing(std::string_view why, HtmlWriter* out);

}  // namespace s2gs
