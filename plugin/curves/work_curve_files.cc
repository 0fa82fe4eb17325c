#include "plugin/curves/work_curve_files.h"

#include <cmath>
#include <nlohmann/json.hpp>
#include <set>
#include <string>
#include <system_error>
#include <vector>

#include "plugin/cli/option_value.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"

namespace s2gs {
namespace {

using Json = nlohmann::ordered_json;

constexpr uint64_t kMaxPointBytes = uint64_t{1} << 20;
constexpr uint64_t kMaxCurveBytes = uint64_t{1} << 28;

Json Number(double value) { return std::isfinite(value) ? Json(value) : Json(nullptr); }

Json SpreadJson(const Spread& spread) {
  return {{"min", Number(spread.min)}, {"median", Number(spread.median)}, {"max", Number(spread.max)}};
}

Json PointJson(const WorkPoint& point) {
  Json figures = Json::object();
  for (const auto& [name, value] : point.figures) figures[name] = Number(value);
  return {{"scene", point.scene},         {"value", point.value},       {"seed", point.seed},
          {"wall_s", point.wall_seconds}, {"cpu_s", point.cpu_seconds}, {"failure", point.failure},
          {"figures", std::move(figures)}};
}

// Quoted where it has to be.
std::string CsvField(const std::string& text) {
  if (text.find_first_of(",\"\n\r") == std::string::npos) return text;
  std::string quoted = "\"";
  for (const char c : text) quoted += c == '"' ? std::string("\"\"") : std::string(1, c);
  return quoted + "\"";
}

// Throws Json::exception for what is no point.
WorkPoint PointOf(const Json& json) {
  WorkPoint point;
  point.scene = static_cast<int>(json.at("scene").get_ref<const int64_t&>());
  point.value = json.at("value").get<std::string>();
  point.seed = json.at("seed").get_ref<const uint64_t&>();
  point.wall_seconds = json.at("wall_s").get<double>();
  point.cpu_seconds = json.at("cpu_s").get<double>();
  point.failure = json.at("failure").get<std::string>();
  for (const auto& [name, value] : json.at("figures").items()) {
    if (value.is_number()) point.figures[name] = value.get<double>();
  }
  return point;
}

std::string Dump(const Json& json) { return json.dump(1, ' ', false, Json::error_handler_t::replace); }

}  // namespace

void WriteCurveCsv(const WorkCurve& curve, std::ostream& out) {
  std::set<std::string> names;
  for (const WorkPoint& point : curve.points) {
    for (const auto& [name, value] : point.figures) names.insert(name);
  }
  out << "knob,value,scene,seed,wall_s,cpu_s,reached,failure";
  for (const std::string& name : names) out << ',' << CsvField(name);
  out << '\n';
  for (const WorkPoint& point : curve.points) {
    out << CsvField(curve.knob) << ',' << CsvField(point.value) << ','
        << CsvField(curve.scenes.at(static_cast<size_t>(point.scene))) << ',' << point.seed << ','
        << FormatValue(point.wall_seconds) << ',' << FormatValue(point.cpu_seconds) << ','
        << (point.Figure(curve.error) ? 1 : 0) << ',' << CsvField(point.failure);
    for (const std::string& name : names) {
      out << ',';
      if (const std::optional<double> value = point.Figure(name)) out << FormatValue(*value);
    }
    out << '\n';
  }
}

void WriteCurveJson(const WorkCurve& curve, std::ostream& out) {
  const std::vector<WorkSetting> settings = SumUp(curve);
  Json json = {{"version", 1},
               {"knob", curve.knob},
               {"what", curve.what},
               {"error", curve.error},
               {"error_text", curve.error_text},
               {"reference", curve.reference},
               {"program", curve.program},
               {"time", curve.time == CurveTime::kWall ? "wall" : "cpu"},
               {"scenes", curve.scenes},
               {"values", curve.values},
               {"points", Json::array()},
               {"settings", Json::array()},
               {"time_to", Json::object()}};
  for (const WorkPoint& point : curve.points) json["points"].push_back(PointJson(point));
  for (const WorkSetting& setting : settings) {
    json["settings"].push_back({{"scene", setting.scene},
                                {"value", setting.value},
                                {"runs", setting.runs},
                                {"reached", setting.reached},
                                {"cpu_s", SpreadJson(setting.cpu_seconds)},
                                {"wall_s", SpreadJson(setting.wall_seconds)},
                                {"error", SpreadJson(setting.error)},
                                {"pareto", setting.is_pareto}});
  }
  for (size_t scene = 0; scene < curve.scenes.size(); ++scene) {
    Json times = Json::object();
    for (const double share : {0.9, 0.99, 0.999}) {
      const std::optional<double> time = TimeToShare(settings, static_cast<int>(scene), share);
      times[FormatValue(share)] = time ? Json(*time) : Json(nullptr);
    }
    json["time_to"][curve.scenes[scene]] = std::move(times);
  }
  out << Dump(json) << '\n';
}

void WritePoint(const std::filesystem::path& path, const std::string& settings, const WorkPoint& point) {
  Json json = PointJson(point);
  json["settings"] = settings;
  WriteFileAtomically(path, [&](std::ostream& out) { out << Dump(json) << '\n'; });
}

std::optional<WorkPoint> ReadPoint(const std::filesystem::path& path, const std::string& settings) {
  std::error_code ec;
  if (!std::filesystem::is_regular_file(path, ec)) return std::nullopt;
  const Json json = Json::parse(ReadWholeFile(path, kMaxPointBytes), nullptr, false);
  try {
    if (!json.is_object() || json.at("settings").get<std::string>() != settings) return std::nullopt;
    return PointOf(json);
  } catch (const Json::exception&) {
    return std::nullopt;  // it runs again
  }
}

WorkCurve ReadCurve(const std::filesystem::path& path) {
  return CurveOfJson(ReadWholeFile(path, kMaxCurveBytes), path);
}

WorkCurve CurveOfJson(const std::string& text, const std::filesystem::path& path) {
  const Json json = Json::parse(text, nullptr, false);
  try {
    WorkCurve curve;
    curve.knob = json.at("knob").get<std::string>();
    curve.what = json.at("what").get<std::string>();
    curve.error = json.at("error").get<std::string>();
    curve.error_text = json.at("error_text").get<std::string>();
    curve.reference = json.at("reference").get<std::string>();
    curve.program = json.at("program").get<std::string>();
    curve.time = json.value("time", "cpu") == "wall" ? CurveTime::kWall : CurveTime::kCpu;
    curve.scenes = json.at("scenes").get<std::vector<std::string>>();
    curve.values = json.at("values").get<std::vector<std::string>>();
    for (const Json& item : json.at("points")) {
      curve.points.push_back(PointOf(item));
      if (curve.points.back().scene < 0 ||
          static_cast<size_t>(curve.points.back().scene) >= curve.scenes.size()) {
        throw UserError(path, "a run is of a scene that is not named", "Make the curve again");
      }
    }
    return curve;
  } catch (const Json::exception&) {
    throw UserError(path, "is no curve of work_precision", "Give the JSON that it wrote");
  }
}

}  // namespace s2gs
