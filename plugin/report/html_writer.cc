#include "plugin/report/html_writer.h"

#include <fmt/format.h>

#include <cmath>

#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

constexpr std::string_view kReplacement = "\xef\xbf\xbd";  // U+FFFD

// Bytes of the UTF-8 sequence that begins at `at`; 0 when there is none (Unicode 15, table 3-7).
size_t Utf8Length(std::string_view text, size_t at) {
  const auto byte = [&](size_t i) -> unsigned {
    return i < text.size() ? static_cast<unsigned char>(text[i]) : 0U;
  };
  const auto follows = [&](size_t i, unsigned low = 0x80, unsigned high = 0xbf) {
    return byte(i) >= low && byte(i) <= high;
  };
  const unsigned first = byte(at);
  if (first < 0x80) return 1;
  if (first >= 0xc2 && first <= 0xdf) return follows(at + 1) ? 2 : 0;
  if (first >= 0xe0 && first <= 0xef) {
    const unsigned low = first == 0xe0 ? 0xa0 : 0x80;
    const unsigned high = first == 0xed ? 0x9f : 0xbf;  // no surrogates
    return follows(at + 1, low, high) && follows(at + 2) ? 3 : 0;
  }
  if (first >= 0xf0 && first <= 0xf4) {
    const unsigned low = first == 0xf0 ? 0x90 : 0x80;
    const unsigned high = first == 0xf4 ? 0x8f : 0xbf;
    return follows(at + 1, low, high) && follows(at + 2) && follows(at + 3) ? 4 : 0;
  }
  return 0;
}

}  // namespace

std::string EscapeHtml(std::string_view text) {
  std::string escaped;
  escaped.reserve(text.size());
  for (size_t at = 0; at < text.size();) {
    const size_t length = Utf8Length(text, at);
    const auto c = static_cast<unsigned char>(text[at]);
    if (length == 0) {
      escaped += kReplacement;
      ++at;
      continue;
    }
    if (c == '&') {
      escaped += "&amp;";
    } else if (c == '<') {
      escaped += "&lt;";
    } else if (c == '>') {
      escaped += "&gt;";
    } else if (c == '"') {
      escaped += "&quot;";
    } else if (c == '\'') {
      escaped += "&#39;";
    } else if ((c < 0x20 && c != '\t' && c != '\n') || c == 0x7f) {
      escaped += kReplacement;
    } else {
      escaped += text.substr(at, length);
    }
    at += length;
  }
  return escaped;
}

std::string ShortNumber(double value, int digits) {
  if (!std::isfinite(value)) return "–";
  std::string text = fmt::format("{:.{}f}", value, digits);
  if (text.find('.') != std::string::npos) {
    text.erase(text.find_last_not_of('0') + 1);
    if (text.back() == '.') text.pop_back();
  }
  return text == "-0" ? "0" : text;
}

std::string Significant(double value, int digits) {
  if (!std::isfinite(value)) return "–";
  if (value == 0) return "0";
  const int before = static_cast<int>(std::floor(std::log10(std::abs(value)))) + 1;
  if (before > 9 || before < -4) return fmt::format("{:.{}g}", value, digits);
  return fmt::format("{:.{}f}", value, std::max(0, digits - before));
}

void HtmlWriter::Start(std::string_view tag, const HtmlAttributes& attributes) {
  html_ += '<';
  html_ += tag;
  for (const auto& [name, value] : attributes) {
    html_ += ' ';
    html_ += name;
    html_ += "=\"";
    html_ += EscapeHtml(value);
    html_ += '"';
  }
}

HtmlWriter& HtmlWriter::Open(std::string_view tag, const HtmlAttributes& attributes) {
  Start(tag, attributes);
  html_ += '>';
  open_.emplace_back(tag);
  return *this;
}

HtmlWriter& HtmlWriter::Close() {
  S2GS_INVARIANT(!open_.empty());
  html_ += "</" + open_.back() + ">";
  // Lines keep the file readable; inside running text a line break would show as a space.
  if (open_.back() != "span" && open_.back() != "b" && open_.back() != "code") html_ += '\n';
  open_.pop_back();
  return *this;
}

HtmlWriter& HtmlWriter::Text(std::string_view text) {
  html_ += EscapeHtml(text);
  return *this;
}

HtmlWriter& HtmlWriter::Element(std::string_view tag, std::string_view text,
                                const HtmlAttributes& attributes) {
  return Open(tag, attributes).Text(text).Close();
}

HtmlWriter& HtmlWriter::Void(std::string_view tag, const HtmlAttributes& attributes) {
  Start(tag, attributes);
  html_ += "/>\n";
  return *this;
}

HtmlWriter& HtmlWriter::Append(const std::string& html) {
  html_ += html;
  return *this;
}

const std::string& HtmlWriter::html() const {
  S2GS_INVARIANT(open_.empty());
  return html_;
}

void WriteRow(const std::vector<std::string>& cells, HtmlWriter* out, std::string_view tag) {
  out->Open("tr");
  for (const std::string& cell : cells) out->Element(tag, cell);
  out->Close();
}

void WriteHeadedRow(const std::vector<std::string>& head, const std::vector<std::string>& cells,
                    HtmlWriter* out) {
  out->Open("tr");
  for (size_t i = 0; i < cells.size(); ++i) {
    out->Element("td", cells[i],
                 {{"data-head", cells[i].empty() || head.at(i).empty() ? "" : head[i] + ": "}});
  }
  out->Close();
}

void WriteTiles(const std::vector<Tile>& tiles, HtmlWriter* out) {
  out->Open("dl", {{"class", "tiles"}});
  for (const Tile& tile : tiles) {
    out->Open("div").Element("dt", tile.what).Element("dd", tile.value);
    if (!tile.note.empty()) out->Element("dd", tile.note, {{"class", "note"}});
    out->Close();
  }
  out->Close();
}

void WriteMissing(std::string_view why, HtmlWriter* out) { out->Element("p", why, {{"class", "missing"}}); }

}  // namespace s2gs
