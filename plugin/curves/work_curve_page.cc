#include "plugin/curves/work_curve_page.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "plugin/report/html_writer.h"

namespace s2gs {
namespace {

// Of a diagram [px].
constexpr double kWidth = 620, kHeight = 380;
constexpr double kLeft = 74, kRight = 20, kTop = 34, kBottom = 52;
constexpr double kMissedY = kTop - 14;  // of settings without a result

constexpr const char* kStyle =
    ":root{color-scheme:light "
    "dark;--ink:#1b1f24;--dim:#667;--grid:#dde;--line:#1f6feb;--best:#1a7f37;--bad:#c62828;"
    "--paper:#fff}\n"
    "@media(prefers-color-scheme:dark){:root{--ink:#e6edf3;--dim:#9aa7b4;--grid:#30363d;--line:#6cb2ff;--"
    "best:#56d364;"
    "--bad:#ff7b72;--paper:#0d1117}}\n"
    "body{font:15px/1.5 "
    "system-ui,sans-serif;color:var(--ink);background:var(--paper);max-width:1300px;margin:2em auto;"
    "padding:0 1em}\n"
    "svg{max-width:100%;height:auto}svg text{fill:var(--ink);font:12px "
    "system-ui,sans-serif}.dim{fill:var(--dim);"
    "color:var(--dim)}\n"
    ".grid{stroke:var(--grid)}.line{stroke:var(--line);fill:none;stroke-width:1.5}.bar{stroke:var(--line)}"
    ".dot{fill:var(--paper);stroke:var(--line);stroke-width:2}\n"
    ".best{fill:var(--best);stroke:var(--best)}.bad{stroke:var(--bad);fill:var(--bad)}\n"
    "table{border-collapse:collapse;margin:1em 0}td,th{padding:.2em .8em;border-bottom:1px solid var(--grid);"
    "text-align:right}td:first-child,th:first-child{text-align:left}\n"
    ".row{display:flex;flex-wrap:wrap;gap:1em}\n";

// A logarithmic axis.
struct Axis {
  double low = 1, high = 10;  // of the values
  double begin = 0, end = 1;  // [px]

  double At(double value) const {
    return begin + (end - begin) * (std::log(value) - std::log(low)) / (std::log(high) - std::log(low));
  }
};

// Over positive values, with room at both ends; an axis of one value still has a length.
Axis AxisOver(const std::vector<double>& values, double begin, double end) {
  Axis axis;
  axis.begin = begin;
  axis.end = end;
  std::vector<double> used;
  for (const double value : values) {
    if (value > 0 && std::isfinite(value)) used.push_back(value);
  }
  if (used.empty()) return axis;
  const auto [low, high] = std::minmax_element(used.begin(), used.end());
  const double room = std::max(0.08 * std::log(*high / *low), 0.2);
  axis.low = *low * std::exp(-room);
  axis.high = *high * std::exp(room);
  return axis;
}

// Round values within an axis: 1, 2 and 5 times powers of ten, or of these the powers alone where many fit.
std::vector<double> Ticks(const Axis& axis) {
  std::vector<double> ticks;
  const int first = static_cast<int>(std::floor(std::log10(axis.low)));
  const int last = static_cast<int>(std::ceil(std::log10(axis.high)));
  for (int power = first; power <= last; ++power) {
    for (const double digit : {1.0, 2.0, 5.0}) {
      if (digit > 1 && last - first > 4) continue;
      const double value = digit * std::pow(10, power);
      if (value >= axis.low && value <= axis.high) ticks.push_back(value);
    }
  }
  return ticks;
}

std::string Text(double x, double y, const char* anchor, const std::string& text, const char* more = "") {
  return fmt::format("<text x=\"{:.1f}\" y=\"{:.1f}\" text-anchor=\"{}\"{}>{}</text>\n", x, y, anchor, more,
                     EscapeHtml(text));
}

std::string Line(const char* kind, double x1, double y1, double x2, double y2) {
  return fmt::format("<line class=\"{}\" x1=\"{:.1f}\" y1=\"{:.1f}\" x2=\"{:.1f}\" y2=\"{:.1f}\"/>\n", kind,
                     x1, y1, x2, y2);
}

std::string Frame(const Axis& x, const Axis& y, const std::string& x_title, const std::string& y_title) {
  std::string svg;
  for (const double value : Ticks(x)) {
    svg += Line("grid", x.At(value), kTop, x.At(value), kHeight - kBottom);
    svg += Text(x.At(value), kHeight - kBottom + 16, "middle", fmt::format("{:.3g}", value));
  }
  for (const double value : Ticks(y)) {
    svg += Line("grid", kLeft, y.At(value), kWidth - kRight, y.At(value));
    svg += Text(kLeft - 6, y.At(value) + 4, "end", fmt::format("{:.3g}", value));
  }
  svg += Text((kLeft + kWidth - kRight) / 2, kHeight - 12, "middle", x_title);
  svg += Text(14, (kTop + kHeight - kBottom) / 2, "middle", y_title,
              fmt::format(" transform=\"rotate(-90 14 {:.1f})\"", (kTop + kHeight - kBottom) / 2).c_str());
  return svg;
}

const char* TimeName(const WorkCurve& curve) {
  return curve.time == CurveTime::kWall ? "wall time" : "CPU time";
}

std::string OpenSvg(const std::string& title) {
  return fmt::format("<svg viewBox=\"0 0 {:.0f} {:.0f}\" width=\"{:.0f}\" role=\"img\" aria-label=\"{}\">\n",
                     kWidth, kHeight, kWidth, EscapeHtml(title));
}

// Error over time for one scene.
std::string ErrorDiagram(const WorkCurve& curve, const std::vector<WorkSetting>& settings, int scene,
                         bool cpu) {
  std::vector<const WorkSetting*> own;
  std::vector<double> times, errors;
  for (const WorkSetting& setting : settings) {
    if (setting.scene != scene) continue;
    own.push_back(&setting);
    const Spread& time = cpu ? setting.cpu_seconds : setting.wall_seconds;
    times.insert(times.end(), {time.min, time.max});
    if (setting.reached > 0) errors.insert(errors.end(), {setting.error.min, setting.error.max});
  }
  const Axis x = AxisOver(times, kLeft, kWidth - kRight);
  const Axis y = AxisOver(errors, kHeight - kBottom, kTop);
  std::string svg = OpenSvg(curve.what + ", " + curve.scenes[static_cast<size_t>(scene)]);
  svg += Frame(x, y, cpu ? "CPU time [s]" : "wall time [s]", curve.error_text);
  // An error of zero has no logarithm: it stands at the lower edge.
  const auto at = [&](double error) { return error > 0 ? y.At(error) : kHeight - kBottom; };
  std::string path;
  bool any_missed = false;
  std::string marks;
  for (const WorkSetting* setting : own) {
    const Spread& time = cpu ? setting->cpu_seconds : setting->wall_seconds;
    const double px = x.At(std::max(time.median, x.low));
    const int missed = setting->runs - setting->reached;
    if (missed > 0) {
      any_missed = true;
      marks += fmt::format(
          "<path class=\"bad\" d=\"M{0:.1f} {2:.1f}L{1:.1f} {3:.1f}M{1:.1f} {2:.1f}L{0:.1f} {3:.1f}\" "
          "stroke-width=\"2\"><title>{4}: {5} of {6} not reached</title></path>\n",
          px - 4, px + 4, kMissedY - 4, kMissedY + 4, EscapeHtml(setting->value), missed, setting->runs);
    }
    if (setting->reached == 0) continue;
    const double py = at(setting->error.median);
    path += fmt::format("{}{:.1f} {:.1f}", path.empty() ? "M" : "L", px, py);
    marks += Line("bar", px, at(setting->error.min), px, at(setting->error.max));
    marks += Line("bar", x.At(std::max(time.min, x.low)), py, x.At(std::max(time.max, x.low)), py);
    marks += fmt::format(
        "<circle class=\"dot{}\" cx=\"{:.1f}\" cy=\"{:.1f}\" r=\"4\"><title>{}: {:.4g}, {:.3g} s"
        "</title></circle>\n",
        setting->is_pareto ? " best" : "", px, py, EscapeHtml(setting->value), setting->error.median,
        time.median);
    marks += Text(px + 6, py - 7, "start", setting->value);
  }
  if (any_missed) svg += Text(kLeft - 6, kMissedY + 4, "end", "not reached");
  svg += "<path class=\"line\" d=\"" + path + "\"/>\n" + marks + "</svg>\n";
  return svg;
}

// Share of scenes over the time's ratio to the fastest.
std::string ProfileDiagram(const WorkCurve& curve, const std::vector<WorkSetting>& settings,
                           double tolerance) {
  const int scenes = static_cast<int>(curve.scenes.size());
  constexpr double kMaxRatio = 100;
  constexpr int kSteps = 200;
  Axis x;
  x.low = 1;
  x.high = kMaxRatio;
  x.begin = kLeft;
  x.end = kWidth - kRight - 60;
  const auto y = [](double share) { return kHeight - kBottom - share * (kHeight - kBottom - kTop); };
  std::string svg = OpenSvg("performance profiles");
  for (const double ratio : Ticks(x)) {
    svg += Line("grid", x.At(ratio), kTop, x.At(ratio), kHeight - kBottom);
    svg += Text(x.At(ratio), kHeight - kBottom + 16, "middle", fmt::format("{:.3g}", ratio));
  }
  for (int k = 0; k <= 4; ++k) {
    svg += Line("grid", kLeft, y(k / 4.0), x.end, y(k / 4.0));
    svg += Text(kLeft - 6, y(k / 4.0) + 4, "end", fmt::format("{} %", 25 * k));
  }
  svg += Text((kLeft + x.end) / 2, kHeight - 12, "middle",
              TimeName(curve) + std::string(" over that of the fastest value"));
  svg += Text(kLeft, kTop - 12, "start",
              fmt::format("share of scenes within {:.0f} % of their least error", 100 * tolerance));
  std::vector<double> used;
  for (const std::string& value : curve.values) {
    std::string path;
    double last = -1;
    for (int k = 0; k <= kSteps; ++k) {
      const double ratio = std::pow(kMaxRatio, static_cast<double>(k) / kSteps);
      const double share = ProfileAt(settings, scenes, value, ratio, tolerance);
      if (last >= 0 && share != last) path += fmt::format("L{:.1f} {:.1f}", x.At(ratio), y(last));
      path += fmt::format("{}{:.1f} {:.1f}", path.empty() ? "M" : "L", x.At(ratio), y(share));
      last = share;
    }
    svg += "<path class=\"line\" d=\"" + path + "\"/>\n";
    double label = y(last) + 4;  // those that end at one height stand below each other
    while (std::any_of(used.begin(), used.end(), [&](double other) { return std::abs(other - label) < 12; }))
      label += 12;
    used.push_back(label);
    svg += Text(x.end + 6, label, "start", value);
  }
  return svg + "</svg>\n";
}

std::string SpreadCell(const Spread& spread) {
  if (!std::isfinite(spread.median)) return "<td>not reached</td>";
  return fmt::format("<td>{:.4g}<br><small class=\"dim\">{:.4g} to {:.4g}</small></td>", spread.median,
                     spread.min, spread.max);
}

}  // namespace

void WriteCurvePage(const WorkCurve& curve, std::ostream& out) {
  constexpr double kTolerance = 0.1;
  const std::vector<WorkSetting> settings = SumUp(curve);
  out << "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\n"
      << "<meta name=\"viewport\" content=\"width=device-width,initial-scale=1\">\n<title>"
      << EscapeHtml(curve.what) << "</title>\n<style>\n"
      << kStyle << "</style></head>\n<body>\n<h1>" << EscapeHtml(curve.what) << "</h1>\n"
      << "<p>Knob <code>" << EscapeHtml(curve.knob) << "</code>, error against <b>"
      << EscapeHtml(curve.reference)
      << "</b>. Points are medians over seeds, bars go from the least to the largest; filled points are the "
         "Pareto "
         "set: nothing is both faster, by "
      << TimeName(curve) << ", and better. s2gs " << EscapeHtml(curve.program) << ".</p>\n";
  for (size_t scene = 0; scene < curve.scenes.size(); ++scene) {
    const int index = static_cast<int>(scene);
    out << "<h2>" << EscapeHtml(curve.scenes[scene]) << "</h2>\n<div class=\"row\">\n"
        << ErrorDiagram(curve, settings, index, true) << ErrorDiagram(curve, settings, index, false)
        << "</div>\n";
    out << "<table><tr><th>value</th><th>CPU time [s]</th><th>wall time [s]</th><th>"
        << EscapeHtml(curve.error_text) << "</th><th>reached</th><th>Pareto</th></tr>\n";
    for (const WorkSetting& setting : settings) {
      if (setting.scene != index) continue;
      out << "<tr><td>" << EscapeHtml(setting.value) << "</td>" << SpreadCell(setting.cpu_seconds)
          << SpreadCell(setting.wall_seconds) << SpreadCell(setting.error) << "<td>" << setting.reached
          << " of " << setting.runs << "</td><td>" << (setting.is_pareto ? "yes" : "") << "</td></tr>\n";
    }
    out << "</table>\n<p>" << TimeName(curve)
        << " to a share of the final quality (1 / error, that of the best setting):";
    for (const double share : {0.9, 0.99, 0.999}) {
      const std::optional<double> time = TimeToShare(settings, index, share);
      out << (time ? fmt::format(" {:.3g} % in {:.3g} s;", 100 * share, *time)
                   : fmt::format(" {:.3g} % not reached;", 100 * share));
    }
    out << "</p>\n";
  }
  if (curve.scenes.size() > 1) {
    out << "<h2>All scenes</h2>\n" << ProfileDiagram(curve, settings, kTolerance);
  }
  bool any_failure = false;
  for (const WorkPoint& point : curve.points) {
    if (point.failure.empty()) continue;
    if (!any_failure) out << "<h2>Not reached</h2>\n<ul>\n";
    any_failure = true;
    out << "<li>" << EscapeHtml(curve.scenes[static_cast<size_t>(point.scene)]) << ", "
        << EscapeHtml(point.value) << ", seed " << point.seed << ": " << EscapeHtml(point.failure)
        << "</li>\n";
  }
  if (any_failure) out << "</ul>\n";
  out << "</body></html>\n";
}

}  // namespace s2gs
