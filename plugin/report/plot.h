#pragma once

#include <string>
#include <utility>
#include <vector>

#include "plugin/report/html_writer.h"

namespace s2gs {

enum class PlotMark { kLine, kDots, kBars };

/// What a diagram shows of one thing.
struct PlotSeries {
  std::string name;  ///< for the legend; empty: it is not named there.
  int color = 0;     ///< of the page's series colours; see SeriesClass().
  PlotMark mark = PlotMark::kLine;
  std::vector<std::pair<double, double>> points;  ///< x, y; those that cannot be drawn are left out.
  std::vector<double> sigmas = {};                ///< of y, for error bars; empty: none.
  std::vector<std::string> titles = {};           ///< shown where the mouse rests; empty: none.
};

struct PlotAxis {
  std::string label;  ///< with the unit.
  bool is_log = false;
};

/// A diagram in the page's colours. Bars are as wide as their distance; log axes leave out what is not
/// positive.
struct Plot {
  std::string title;
  PlotAxis x;
  PlotAxis y;
  std::vector<PlotSeries> series;
  bool y_from_zero = false;  ///< for counts.
};

/// An SVG in a figure; a sentence instead where there is nothing to draw.
void WritePlot(const Plot& plot, HtmlWriter* out);

/// The class of the page's style for a station or another thing that is told by colour: "s0" to "s7".
std::string SeriesClass(int index);

/// Values at which an axis from `low` to `high` (low < high) has its marks: three to eight of 1, 2 or 5 times
/// a power of ten; on a log axis powers of ten, with 2 and 5 where it spans less than two decades.
std::vector<double> AxisMarks(double low, double high, bool is_log);

}  // namespace s2gs
