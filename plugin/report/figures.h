#pragma once

#include <ostream>
#include <string>
#include <utility>
#include <vector>

namespace s2gs {

/// One thing that was, or could not be, measured.
struct Figure {
  std::string name;                                    ///< in snake case, e.g. "object_rot_deg".
  std::string unit;                                    ///< "degrees", "%", "dB"; empty for counts and ratios.
  std::string definition;                              ///< a sentence without full stop.
  std::vector<std::pair<std::string, double>> values;  ///< statistic and value, e.g. ("median", 0.1).
  std::string missing;                                 ///< why, when there are no values.
};

/// Figures in the order in which they are shown.
using Figures = std::vector<Figure>;

bool IsAnythingMeasured(const Figures& figures);

/// A table for people, one line a figure.
void PrintFigures(const Figures& figures, std::ostream& out);

/// {"version": 1, "figures": {NAME: {"unit", "definition", STATISTIC: number, ...}}, "missing": {NAME:
/// reason}}. Numbers come with all their digits; infinite ones as the strings "inf" and "-inf".
void WriteFiguresJson(const Figures& figures, std::ostream& out);

/// Columns figure, statistic, value, unit, missing; one line a value, or one for a figure without values.
void WriteFiguresCsv(const Figures& figures, std::ostream& out);

}  // namespace s2gs
