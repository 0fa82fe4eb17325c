#pragma once

#include <filesystem>
#include <optional>
#include <ostream>
#include <string>

#include "plugin/curves/work_curve.h"

namespace s2gs {

/// One line a run: knob, value, scene, seed, wall_s, cpu_s, reached, failure, and a column for every figure.
void WriteCurveCsv(const WorkCurve& curve, std::ostream& out);

/// {"version": 1, "knob", "what", "error", "error_text", "reference", "program", "time": "cpu" or "wall",
/// "scenes", "values", "points":
/// [...], "settings": [medians with least and largest, "pareto"], "time_to": {scene: {"0.9": seconds or
/// null}}}.
void WriteCurveJson(const WorkCurve& curve, std::ostream& out);

/// A curve that WriteCurveJson() wrote. Throws UserError for any other file.
WorkCurve ReadCurve(const std::filesystem::path& path);
/// The same of a text. \param path  where it stands, for what is thrown.
WorkCurve CurveOfJson(const std::string& json, const std::filesystem::path& path);

/// A finished run, kept in its folder so that it is not made again: atomically.
/// \param settings  everything that the run depends on; another text makes it another run.
void WritePoint(const std::filesystem::path& path, const std::string& settings, const WorkPoint& point);

/// Nothing when there is no such file, it is damaged, or of other settings.
std::optional<WorkPoint> ReadPoint(const std::filesystem::path& path, const std::string& settings);

}  // namespace s2gs
