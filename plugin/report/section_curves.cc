#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <map>

#include "plugin/report/plot.h"
#include "plugin/report/sections.h"

namespace s2gs {
namespace {

using Json = nlohmann::json;
using Curve = std::vector<std::pair<double, double>>;

nlohmann::ordered_json ToJson(const Curve& curve) {
  nlohmann::ordered_json points = nlohmann::ordered_json::array();
  for (const auto& [seconds, error] : curve) points.push_back({seconds, FiniteOrNull(error)});
  return points;
}

bool HasNumbers(const Curve& curve) {
  return std::any_of(curve.begin(), curve.end(),
                     [](const auto& point) { return std::isfinite(point.second); });
}

PlotSeries Series(const char* name, int color, Curve points, PlotMark mark = PlotMark::kLine) {
  PlotSeries series;
  series.name = name;
  series.color = color;
  series.mark = mark;
  series.points = std::move(points);
  return series;
}

void AddPoses(const ReportInput& input, ReportSection* section) {
  Plot plot{"Poses: each round of the joint adjustment",
            {"time [s]", true},
            {"residual, rms [px]", true},
            {},
            false};
  Curve object;
  Curve background;
  double seconds = 0;
  if (input.mapper.is_object() && input.mapper.contains("rounds")) {
    for (const Json& round : input.mapper["rounds"]) {
      seconds += NumberOr(round, "seconds");
      object.emplace_back(seconds, NumberOr(round, "object_rms_px"));
      background.emplace_back(seconds, NumberOr(round, "background_rms_px"));
    }
  }
  if (!object.empty()) {
    section->numbers["poses"] = {
        {"unit", "px"}, {"object", ToJson(object)}, {"background", ToJson(background)}};
    plot.series = {Series("rotating part", 0, object)};
    if (HasNumbers(background)) plot.series.push_back(Series("background", 1, background));
  }
  WritePlot(plot, &section->html);
}

void AddTraining(const ReportInput& input, ReportSection* section) {
  Curve loss;
  Curve colour;
  bool has_parts = false;
  Curve held_out;
  Curve held_out_object;
  Curve dssim;
  for (const Json& line : input.log) {
    if (line.value("stage", "") != "train") continue;
    const double seconds = NumberOr(line, "wall_s");
    const std::string event = line.value("event", "");
    const bool is_whole = line.value("whole", true);
    has_parts = has_parts || !is_whole;
    if (event == "loss" && line.contains("loss") && is_whole) {
      loss.emplace_back(seconds, NumberOr(line["loss"], "total"));
      colour.emplace_back(seconds, NumberOr(line["loss"], "l1"));
    }
    if (event == "held_out") {
      // Root mean square error of values from 0 to 1.
      held_out.emplace_back(seconds, std::pow(10.0, -NumberOr(line, "psnr_db") / 20));
      held_out_object.emplace_back(seconds, std::pow(10.0, -NumberOr(line, "object_psnr_db") / 20));
      dssim.emplace_back(seconds, 1 - NumberOr(line, "ssim"));
    }
  }
  Plot plot{"Training: error on the photos that it sees", {"time [s]", true}, {"loss", true}, {}, false};
  if (!loss.empty()) {
    section->numbers["training"] = {{"loss", ToJson(loss)}, {"l1", ToJson(colour)}};
    plot.series = {Series("whole loss", 0, loss), Series("colour, mean absolute", 1, colour)};
  }
  if (has_parts) section->numbers["training"]["some_draw_the_rotating_part_alone"] = true;
  WritePlot(plot, &section->html);
  if (held_out.empty()) return;
  section->numbers["held_out"] = {
      {"rms", ToJson(held_out)}, {"object_rms", ToJson(held_out_object)}, {"one_minus_ssim", ToJson(dssim)}};
  Plot held{"Training: error on photos held back", {"time [s]", true}, {"error", true}, {}, false};
  held.series = {Series("colour, rms (0 to 1)", 0, held_out), Series("1 − SSIM", 2, dssim)};
  if (HasNumbers(held_out_object)) held.series.push_back(Series("of the object alone", 1, held_out_object));
  WritePlot(held, &section->html);
}

// One curve for each error that the mesh's lines name.
void AddMesh(const ReportInput& input, ReportSection* section) {
  std::map<std::string, Curve> curves;
  for (const Json& line : input.log) {
    if (line.value("stage", "") != "mesh" || !line.contains("errors") || !line["errors"].is_object())
      continue;
    for (const auto& [name, error] : line["errors"].items()) {
      if (error.is_number()) curves[name].emplace_back(NumberOr(line, "wall_s"), error.get<double>());
    }
  }
  if (curves.empty()) return;
  Plot plot{"Mesh: photos compared on its surface", {"time [s]", true}, {"error", true}, {}, false};
  for (const auto& [name, curve] : curves) {
    section->numbers["mesh"][name] = ToJson(curve);
    plot.series.push_back(Series(name.c_str(), static_cast<int>(plot.series.size()), curve));
  }
  WritePlot(plot, &section->html);
}

}  // namespace

ReportSection CurvesSection(const ReportInput& input) {
  ReportSection section{"curves", "Error against time", {}, {}};
  section.numbers = nlohmann::ordered_json::object();
  HtmlWriter& out = section.html;
  out.Open("div", {{"class", "figures"}});
  AddPoses(input, &section);
  AddTraining(input, &section);
  AddMesh(input, &section);
  out.Close();
  std::string note =
      "Both axes are logarithmic: a straight line that falls is progress at a constant rate, a flat end is "
      "time that bought nothing. ";
  if (section.numbers.contains("training")) {
    note +=
        "Training's own error steps up where the photos become larger (it starts with small ones) and where "
        "further terms of the loss begin. ";
    if (section.numbers["training"].contains("some_draw_the_rotating_part_alone")) {
      note +=
          "Late iterations that look only where the rotating part is are not shown: their error is that of "
          "less than a photo. ";
    }
  }
  note += "Without truth or photos held back, these are the errors that the program itself works to reduce.";
  out.Element("p", note, {{"class", "note"}});
  return section;
}

}  // namespace s2gs
