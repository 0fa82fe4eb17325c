#include "plugin/report/plot.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

namespace s2gs {
namespace {

constexpr double kWidth = 480;
constexpr double kHeight = 300;
constexpr double kLeft = 62;      // room for five characters beside the axis' name
constexpr double kCharacter = 7;  // width of a digit
constexpr double kRight = 14;
constexpr double kTop = 12;
constexpr double kBottom = 46;
constexpr size_t kMaxLinePoints = 400;

struct Range {
  double low = std::numeric_limits<double>::infinity();
  double high = -std::numeric_limits<double>::infinity();

  void Add(double value) {
    low = std::min(low, value);
    high = std::max(high, value);
  }
  bool IsEmpty() const { return !(low <= high); }
};

bool CanDraw(double value, const PlotAxis& axis) {
  return std::isfinite(value) && (!axis.is_log || value > 0);
}

// Room around the data, in the axis's own measure; never empty.
Range Widened(Range range, const PlotAxis& axis, bool from_zero) {
  if (axis.is_log) {
    const double margin = std::max(0.04 * std::log(range.high / range.low), 0.05);
    return {range.low * std::exp(-margin), range.high * std::exp(margin)};
  }
  if (from_zero) range.low = std::min(range.low, 0.0);
  double margin = 0.04 * (range.high - range.low);
  if (!(margin > 0)) margin = range.high != 0 ? 0.1 * std::abs(range.high) : 1;
  return {from_zero && range.low == 0 ? 0 : range.low - margin, range.high + margin};
}

std::string MarkText(double value) {
  const double size = std::abs(value);
  if (size != 0 && (size >= 1e5 || size < 1e-3)) {
    std::string text = fmt::format("{:.0e}", value);
    const size_t e = text.find('e');
    return text.substr(0, e + 1) + std::to_string(std::stoi(text.substr(e + 1)));
  }
  return ShortNumber(value, 4);
}

class Canvas {
 public:
  Canvas(const Plot& plot, const Range& x, const Range& y) : plot_(plot), x_(x), y_(y) {
    for (const double mark : AxisMarks(y.low, y.high, plot.y.is_log)) {
      left_ = std::max(left_, kLeft + kCharacter * (static_cast<double>(MarkText(mark).size()) - 5));
    }
  }

  double X(double value) const { return left_ + Share(value, x_, plot_.x) * (kWidth - left_ - kRight); }
  double Y(double value) const {
    return kHeight - kBottom - Share(value, y_, plot_.y) * (kHeight - kTop - kBottom);
  }

  void WriteAxes(HtmlWriter* out) const {
    for (const double mark : AxisMarks(x_.low, x_.high, plot_.x.is_log)) {
      const std::string x = ShortNumber(X(mark));
      out->Void("line", {{"class", "grid"},
                         {"x1", x},
                         {"x2", x},
                         {"y1", ShortNumber(kTop)},
                         {"y2", ShortNumber(kHeight - kBottom)}});
      out->Element("text", MarkText(mark),
                   {{"x", x}, {"y", ShortNumber(kHeight - kBottom + 17)}, {"text-anchor", "middle"}});
    }
    for (const double mark : AxisMarks(y_.low, y_.high, plot_.y.is_log)) {
      const std::string y = ShortNumber(Y(mark));
      out->Void("line", {{"class", "grid"},
                         {"x1", ShortNumber(left_)},
                         {"x2", ShortNumber(kWidth - kRight)},
                         {"y1", y},
                         {"y2", y}});
      out->Element("text", MarkText(mark),
                   {{"x", ShortNumber(left_ - 7)}, {"y", ShortNumber(Y(mark) + 4)}, {"text-anchor", "end"}});
    }
    out->Element("text", plot_.x.label,
                 {{"class", "axis"},
                  {"x", ShortNumber((left_ + kWidth - kRight) / 2)},
                  {"y", ShortNumber(kHeight - 9)},
                  {"text-anchor", "middle"}});
    const double middle = (kTop + kHeight - kBottom) / 2;
    out->Element("text", plot_.y.label,
                 {{"class", "axis"},
                  {"transform", fmt::format("translate(14 {}) rotate(-90)", ShortNumber(middle))},
                  {"text-anchor", "middle"}});
  }

  void Write(const PlotSeries& series, HtmlWriter* out) const {
    out->Open("g", {{"class", SeriesClass(series.color)}});
    if (series.mark == PlotMark::kLine) WriteLine(series, out);
    if (series.mark == PlotMark::kDots) WriteDots(series, out);
    if (series.mark == PlotMark::kBars) WriteBars(series, out);
    out->Close();
  }

 private:
  static double Share(double value, const Range& range, const PlotAxis& axis) {
    if (axis.is_log) return std::log(value / range.low) / std::log(range.high / range.low);
    return (value - range.low) / (range.high - range.low);
  }
  bool IsDrawn(const std::pair<double, double>& point) const {
    return CanDraw(point.first, plot_.x) && CanDraw(point.second, plot_.y);
  }

  void WriteLine(const PlotSeries& series, HtmlWriter* out) const {
    std::vector<std::pair<double, double>> points;
    std::copy_if(series.points.begin(), series.points.end(), std::back_inserter(points),
                 [&](const auto& point) { return IsDrawn(point); });
    // More points than pixels would only make the page larger.
    const size_t stride = points.size() / kMaxLinePoints + 1;
    std::string path;
    for (size_t i = 0; i < points.size(); ++i) {
      if (i % stride != 0 && i + 1 != points.size()) continue;
      path += fmt::format("{}{} {}", path.empty() ? "M" : "L", ShortNumber(X(points[i].first), 1),
                          ShortNumber(Y(points[i].second), 1));
    }
    out->Void("path", {{"class", "line"}, {"d", path}});
    if (points.size() <= 12) WriteDots(series, out);
  }

  void WriteDots(const PlotSeries& series, HtmlWriter* out) const {
    for (size_t i = 0; i < series.points.size(); ++i) {
      const auto& [x, y] = series.points[i];
      if (!IsDrawn(series.points[i])) continue;
      if (i < series.sigmas.size() && std::isfinite(series.sigmas[i]) && !plot_.y.is_log) {
        const std::string at = ShortNumber(X(x), 1);
        out->Void("line", {{"class", "sigma"},
                           {"x1", at},
                           {"x2", at},
                           {"y1", ShortNumber(Y(y - series.sigmas[i]), 1)},
                           {"y2", ShortNumber(Y(y + series.sigmas[i]), 1)}});
      }
      out->Open("circle", {{"class", "dot"},
                           {"cx", ShortNumber(X(x), 1)},
                           {"cy", ShortNumber(Y(y), 1)},
                           {"r", series.points.size() > 100 ? "2.2" : "3"}});
      if (i < series.titles.size()) out->Element("title", series.titles[i]);
      out->Close();
    }
  }

  void WriteBars(const PlotSeries& series, HtmlWriter* out) const {
    double width = std::numeric_limits<double>::infinity();
    for (size_t i = 1; i < series.points.size(); ++i) {
      width = std::min(width, X(series.points[i].first) - X(series.points[i - 1].first));
    }
    if (!std::isfinite(width)) width = 20;
    for (size_t i = 0; i < series.points.size(); ++i) {
      const auto& [x, y] = series.points[i];
      if (!IsDrawn(series.points[i]) || !(y > 0)) continue;
      const double bottom = kHeight - kBottom;
      out->Open("rect", {{"class", "bar"},
                         {"x", ShortNumber(X(x) - width / 2, 1)},
                         {"y", ShortNumber(Y(y), 1)},
                         {"width", ShortNumber(std::max(0.5, width - 1), 1)},
                         {"height", ShortNumber(bottom - Y(y), 1)}});
      if (i < series.titles.size()) out->Element("title", series.titles[i]);
      out->Close();
    }
  }

  const Plot& plot_;
  double left_ = kLeft;
  Range x_;
  Range y_;
};

}  // namespace

std::string SeriesClass(int index) { return "s" + std::to_string((index % 8 + 8) % 8); }

std::vector<double> AxisMarks(double low, double high, bool is_log) {
  std::vector<double> marks;
  if (is_log) {
    const bool has_few = high / low < 100;
    for (int e = static_cast<int>(std::floor(std::log10(low))); std::pow(10.0, e) <= high; ++e) {
      for (const double digit : {1.0, 2.0, 5.0}) {
        const double mark = digit * std::pow(10.0, e);
        if (mark >= low && mark <= high && (digit == 1 || has_few)) marks.push_back(mark);
      }
    }
    if (marks.size() >= 2) return marks;
    marks.clear();
  }
  const double rough = (high - low) / 5;
  const double power = std::pow(10.0, std::floor(std::log10(rough)));
  const double digit = rough / power < 1.5 ? 1 : rough / power < 3.5 ? 2 : rough / power < 7.5 ? 5 : 10;
  const double step = digit * power;
  for (double k = std::ceil(low / step); k * step <= high; k += 1) marks.push_back(k * step);
  return marks;
}

void WritePlot(const Plot& plot, HtmlWriter* out) {
  Range x;
  Range y;
  for (const PlotSeries& series : plot.series) {
    for (size_t i = 0; i < series.points.size(); ++i) {
      const auto& [px, py] = series.points[i];
      if (!CanDraw(px, plot.x) || !CanDraw(py, plot.y)) continue;
      x.Add(px);
      y.Add(py);
      if (i < series.sigmas.size() && std::isfinite(series.sigmas[i]) && !plot.y.is_log) {
        y.Add(py - series.sigmas[i]);
        y.Add(py + series.sigmas[i]);
      }
    }
  }
  out->Open("figure").Element("figcaption", plot.title);
  if (x.IsEmpty()) {
    WriteMissing("nothing was recorded", out);
    out->Close();
    return;
  }
  const Canvas canvas(plot, Widened(x, plot.x, false), Widened(y, plot.y, plot.y_from_zero));
  out->Open("svg", {{"class", "plot"},
                    {"viewBox", fmt::format("0 0 {} {}", kWidth, kHeight)},
                    {"role", "img"},
                    {"aria-label", plot.title}});
  canvas.WriteAxes(out);
  for (const PlotSeries& series : plot.series) canvas.Write(series, out);
  out->Close();
  out->Open("p", {{"class", "legend"}});
  for (const PlotSeries& series : plot.series) {
    if (series.name.empty()) continue;
    out->Open("span", {{"class", SeriesClass(series.color)}}).Element("i", "").Text(series.name).Close();
  }
  out->Close().Close();
}

}  // namespace s2gs
