#include "plugin/cli/help_table.h"

#include <algorithm>

namespace s2gs {
namespace {

constexpr size_t kMaxDefaultWidth = 24;  // a longer default has its meaning on the next line
constexpr size_t kMinMeaningWidth = 30;  // however wide the other columns are
constexpr size_t kGap = 2;               // between columns, and before the first

std::string Padded(const std::string& cell, size_t width) {
  return cell + std::string(width > cell.size() ? width - cell.size() : 0, ' ');
}

struct Widths {
  size_t option = 0, value = 0, unit = 0;
  bool has_units = false;

  void Include(const HelpRow& row) {
    option = std::max(option, row.option.size());
    if (row.value.size() <= kMaxDefaultWidth) value = std::max(value, row.value.size());
    unit = std::max(unit, row.unit.size());
  }
  size_t Indent() const { return kGap + option + kGap + value + (has_units ? kGap + unit : 0) + kGap; }
};

std::string RowText(const HelpRow& row, const Widths& widths) {
  const std::string gap(kGap, ' ');
  std::string line = gap + Padded(row.option, widths.option) + gap + Padded(row.value, widths.value);
  if (widths.has_units) line += gap + Padded(row.unit, widths.unit);
  const size_t indent = widths.Indent();
  const size_t width = std::max(kHelpWidth > indent ? kHelpWidth - indent : 0, kMinMeaningWidth);
  std::string text;
  if (line.size() + kGap > indent) {
    text += line + "\n";
    line.clear();
  }
  for (const std::string& part : Wrapped(row.meaning, width)) {
    text += Padded(line, indent) + part + "\n";
    line.clear();
  }
  return text;
}

}  // namespace

std::vector<std::string> Wrapped(const std::string& text, size_t width) {
  std::vector<std::string> lines(1);
  size_t begin = 0;
  while (begin < text.size()) {
    size_t end = text.find(' ', begin);
    if (end == std::string::npos) end = text.size();
    const std::string word = text.substr(begin, end - begin);
    if (!lines.back().empty() && lines.back().size() + 1 + word.size() > width) lines.emplace_back();
    lines.back() += (lines.back().empty() ? "" : " ") + word;
    begin = end + 1;
  }
  return lines;
}

std::string HelpTable::Text() const {
  const HelpRow header = {"option", "default", "unit", "meaning (bounds)"};
  Widths widths;
  for (const Line& line : lines_) widths.has_units = widths.has_units || !line.row.unit.empty();
  widths.Include(header);
  for (const Line& line : lines_) widths.Include(line.row);
  std::string text = RowText(header, widths);
  for (const Line& line : lines_) {
    if (!line.row.option.empty()) {
      text += RowText(line.row, widths);
      continue;
    }
    text += "\n";
    if (line.title.empty()) continue;
    for (const std::string& part : Wrapped(line.title, kHelpWidth)) text += part + "\n";
  }
  return text;
}

}  // namespace s2gs
