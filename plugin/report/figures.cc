#include "plugin/report/figures.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

namespace s2gs {
namespace {

nlohmann::ordered_json JsonNumber(double value) {
  if (std::isfinite(value)) return value;
  if (std::isnan(value)) return nullptr;
  return value > 0 ? "inf" : "-inf";
}

// Quoted when the text would otherwise end its cell.
std::string CsvCell(const std::string& text) {
  if (text.find_first_of(",\"\n\r") == std::string::npos) return text;
  std::string quoted = "\"";
  for (const char c : text) quoted += c == '"' ? std::string("\"\"") : std::string(1, c);
  return quoted + "\"";
}

}  // namespace

bool IsAnythingMeasured(const Figures& figures) {
  return std::any_of(figures.begin(), figures.end(),
                     [](const Figure& figure) { return !figure.values.empty(); });
}

void PrintFigures(const Figures& figures, std::ostream& out) {
  size_t width = 0;
  for (const Figure& figure : figures) width = std::max(width, figure.name.size());
  for (const Figure& figure : figures) {
    std::string cells;
    for (const auto& [statistic, value] : figure.values) {
      cells += fmt::format("{:>7} {:<10}", statistic, fmt::format("{:.5g}", value));
    }
    if (figure.values.empty()) {
      cells = "missing: " + figure.missing;
    } else {
      cells += figure.unit;
    }
    out << fmt::format("{:{}}  {}\n", figure.name, width, cells);
  }
}

void WriteFiguresJson(const Figures& figures, std::ostream& out) {
  nlohmann::ordered_json measured = nlohmann::ordered_json::object();
  nlohmann::ordered_json missing = nlohmann::ordered_json::object();
  for (const Figure& figure : figures) {
    if (figure.values.empty()) {
      missing[figure.name] = figure.missing;
      continue;
    }
    nlohmann::ordered_json& entry = measured[figure.name];
    entry["unit"] = figure.unit;
    entry["definition"] = figure.definition;
    for (const auto& [statistic, value] : figure.values) entry[statistic] = JsonNumber(value);
  }
  const nlohmann::ordered_json document = {{"version", 1}, {"figures", measured}, {"missing", missing}};
  // Names of files may hold any bytes.
  out << document.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace) << "\n";
}

void WriteFiguresCsv(const Figures& figures, std::ostream& out) {
  out << "figure,statistic,value,unit,missing\n";
  for (const Figure& figure : figures) {
    if (figure.values.empty()) {
      out << CsvCell(figure.name) << ",,," << CsvCell(figure.unit) << "," << CsvCell(figure.missing) << "\n";
    }
    for (const auto& [statistic, value] : figure.values) {
      out << CsvCell(figure.name) << "," << statistic << "," << fmt::format("{}", value) << ","
          << CsvCell(figure.unit) << ",\n";
    }
  }
}

}  // namespace s2gs
