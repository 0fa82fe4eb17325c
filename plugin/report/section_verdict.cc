#include <fmt/format.h>

#include <cmath>
#include <system_error>

#include "plugin/report/scan_verdict.h"
#include "plugin/report/sections.h"

namespace s2gs {
namespace {

using Grade = ScanVerdict::Grade;

// What a scan still lacks: the command to run next; empty when everything is there.
std::string NextCommand(const ReportInput& input) {
  std::error_code ec;
  const Workspace& w = input.workspace;
  for (const auto& [path, command] :
       {std::pair(w.SplitLabels(), "motion_splitter"), std::pair(w.ObjectModel(), "turntable_mapper"),
        std::pair(w.PointCloud(), "gaussian_trainer"), std::pair(w.DepthMaps(), "gaussian_renderer"),
        std::pair(w.TsdfMesh(), "tsdf_mesher")}) {
    if (!std::filesystem::exists(path, ec)) return command;
  }
  return "";
}

std::string Joined(const std::vector<std::string>& phrases) {
  std::string text;
  for (const std::string& phrase : phrases) text += (text.empty() ? "" : "; ") + phrase;
  return text;
}

std::string Sentence(const ReportInput& input, const ScanVerdict& verdict) {
  const nlohmann::json& mapper = input.mapper;
  switch (verdict.grade) {
    case Grade::kUnknown:
      return "No judgement yet: the cameras have not been computed.";
    case Grade::kFailed:
      return "The scan failed: " + Joined(verdict.reasons) + ".";
    case Grade::kDoubtful:
      return "The scan is doubtful: " + Joined(verdict.reasons) + ".";
    case Grade::kGood:
      break;
  }
  std::string text = fmt::format("The scan is good: {} of {} photos have a pose",
                                 NumberOr(mapper, "registered"), NumberOr(mapper, "images"));
  const nlohmann::json sigma = mapper.value("sigma", nlohmann::json::object());
  const double angle = NumberOr(sigma, "angle_median_deg");
  if (std::isfinite(angle)) text += fmt::format(", table angles are known to ±{}°", Significant(angle, 2));
  const double rms = NumberOr(mapper.value("object", nlohmann::json::object()), "adjusted_rms_px");
  if (std::isfinite(rms))
    text += fmt::format(" and the object's keypoints are met to {} px", Significant(rms, 2));
  return text + ".";
}

std::vector<Tile> KeyFigures(const ReportInput& input) {
  std::vector<Tile> tiles;
  const nlohmann::json& mapper = input.mapper;
  size_t placed = 0;
  for (const std::string& name : input.photos) placed += input.ObjectImage(name) != nullptr ? 1 : 0;
  if (!input.photos.empty()) {
    tiles.push_back({"Photos with a pose", fmt::format("{} of {}", placed, input.photos.size()),
                     input.turntable ? "from " + Count(input.turntable->num_stations, "station") : ""});
  }
  if (mapper.is_object()) {
    const nlohmann::json sigma = mapper.value("sigma", nlohmann::json::object());
    const double rms = NumberOr(mapper.value("object", nlohmann::json::object()), "adjusted_rms_px");
    if (std::isfinite(rms)) {
      tiles.push_back({"Residual", Significant(rms, 2) + " px", "rms of the rotating part's keypoints"});
    }
    const double angle = NumberOr(sigma, "angle_median_deg");
    if (std::isfinite(angle)) {
      tiles.push_back({"Table angles", "± " + Significant(angle, 2) + "°", "median standard deviation"});
    }
  }
  for (auto line = input.log.rbegin(); line != input.log.rend(); ++line) {
    const double psnr = NumberOr(*line, "psnr_db");
    if (std::isnan(psnr)) continue;
    tiles.push_back({"Held-back photos", Significant(psnr, 3) + " dB", "PSNR of the trained model"});
    break;
  }
  double seconds = 0;
  for (const StageStatus& stage : input.stages) {
    if (stage.stamp && stage.name != "report") seconds += stage.stamp->seconds;
  }
  if (seconds > 0) {
    tiles.push_back({"Time",
                     seconds < 120 ? Significant(seconds, 2) + " s" : Significant(seconds / 60, 2) + " min",
                     "of all stages together"});
  }
  return tiles;
}

}  // namespace

ReportSection VerdictSection(const ReportInput& input) {
  ReportSection section{"verdict", "", {}, {}};
  const ScanVerdict verdict = JudgeScan(input);
  const std::string sentence = Sentence(input, verdict);
  const std::string next = NextCommand(input);
  section.numbers = {{"verdict", GradeName(verdict.grade)},
                     {"sentence", sentence},
                     {"reasons", verdict.reasons},
                     {"advice", verdict.advice},
                     {"next_command", next}};
  HtmlWriter& out = section.html;
  out.Open("div", {{"class", std::string("verdict ") + GradeName(verdict.grade)}});
  out.Element("b", GradeName(verdict.grade), {{"class", "grade"}});
  out.Element("p", sentence, {{"class", "sentence"}});
  if (!verdict.advice.empty()) {
    out.Open("ul");
    for (const std::string& advice : verdict.advice) out.Element("li", advice + ".");
    out.Close();
  }
  if (!next.empty()) {
    out.Open("p").Text("Not everything has run: next comes ").Element("code", "s2gs " + next);
    out.Text(", or ")
        .Element("code", "s2gs automatic_scanner")
        .Text(", which runs all that is missing.")
        .Close();
  } else if (verdict.grade == Grade::kGood) {
    out.Element("p", "Nothing needs to be photographed again: look at the warnings below, then at the mesh.");
  }
  for (const std::string& problem : input.problems) WriteMissing(problem, &out);
  out.Close();
  WriteTiles(KeyFigures(input), &out);
  return section;
}

}  // namespace s2gs
