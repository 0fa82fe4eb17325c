#include <fmt/format.h>

#include <cmath>
#include <system_error>

#include "plugin/cli/shell_quote.h"
#include "plugin/report/sections.h"

namespace s2gs {
namespace {

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

// To be copied into a shell.
std::string ScanCommand(const ReportInput& input, const std::vector<std::string>& more) {
  std::vector<std::string> words = {"s2gs", "automatic_scanner", "--workspace_path",
                                    input.workspace.root.string()};
  if (!input.image_path.empty()) {
    words.insert(words.end(), {"--image_path", input.image_path.string()});
  }
  words.insert(words.end(), more.begin(), more.end());
  return ShellQuoted(words);
}

std::string Sentence(const ReportInput& input, const ScanSummary::PoseVerdict& verdict) {
  const nlohmann::json& mapper = input.mapper;
  if (mapper.is_null()) return "No judgement yet: the cameras have not been computed.";
  if (verdict.verdict.empty()) {
    return "No judgement: an older turntable_mapper made the poses; run it again to have them judged.";
  }
  const std::string photos =
      fmt::format("{} of {} photos have a pose", NumberOr(mapper, "registered"), NumberOr(mapper, "images"));
  if (verdict.verdict == "failed") return fmt::format("The scan failed: {}.", photos);
  std::string text = fmt::format("The scan is {}: {}", verdict.verdict, photos);
  const double angle = NumberOr(mapper.value("sigma", nlohmann::json::object()), "angle_median_deg");
  const double rms = NumberOr(mapper.value("object", nlohmann::json::object()), "adjusted_rms_px");
  if (verdict.verdict == "good" && angle > 0 && rms > 0) {
    text += fmt::format(", table angles are known to ±{}° and the object's keypoints are met to {} px",
                        Significant(angle, 2), Significant(rms, 2));
  }
  if (verdict.verdict == "doubtful") {
    text += verdict.poses_hold ? ", and those hold" : ", but they may be wrong";
  }
  return text + ".";
}

// A class of the page's style: a file's text must not become one.
std::string StyleOf(const std::string& verdict) {
  for (const char* known : {"good", "doubtful", "failed"}) {
    if (verdict == known) return verdict;
  }
  return "unknown";
}

void WriteList(const char* title, const std::vector<std::string>& lines, HtmlWriter* out) {
  if (lines.empty()) return;
  out->Element("h3", title).Open("ul");
  for (const std::string& line : lines) out->Element("li", line);
  out->Close();
}

std::vector<Tile> KeyFigures(const ReportInput& input, bool poses_hold) {
  std::vector<Tile> tiles;
  const nlohmann::json& mapper = input.mapper;
  size_t placed = 0;
  for (const std::string& name : input.photos) placed += input.ObjectImage(name) != nullptr ? 1 : 0;
  if (!input.photos.empty()) {
    tiles.push_back({"Photos with a pose", fmt::format("{} of {}", placed, input.photos.size()),
                     !input.turntable     ? ""
                     : input.ShowsATurn() ? "from " + Count(input.turntable->num_stations, "station")
                                          : "nothing turned before the camera"});
  }
  if (mapper.is_object()) {
    const nlohmann::json sigma = mapper.value("sigma", nlohmann::json::object());
    const double rms = NumberOr(mapper.value("object", nlohmann::json::object()), "adjusted_rms_px");
    // None at all: nothing was adjusted, since no point was seen twice.
    if (rms > 0) {
      tiles.push_back({"Residual", Significant(rms, 2) + " px", "rms of the rotating part's keypoints"});
    }
    const nlohmann::json verdict = mapper.value("verdict", nlohmann::json::object());
    if (verdict.is_object()) {
      const nlohmann::json measured = verdict.value("measured", nlohmann::json::object());
      const double share = NumberOr(measured.value("held_back", nlohmann::json::object()), "share");
      if (std::isfinite(share)) {
        tiles.push_back({"Details held back", ShortNumber(100 * share, 1) + " %",
                         "of them agree with the poses, chance taken off"});
      }
    }
    const double angle = NumberOr(sigma, "angle_median_deg");
    // 0: the adjustment held the angles and knows nothing of them.
    if (angle > 0) {
      // Noise is all that a standard deviation knows of: where poses are wrong it says nothing.
      tiles.push_back(
          {"Table angles", "± " + Significant(angle, 2) + "°",
           poses_hold ? "median standard deviation" : "median standard deviation, were the poses right"});
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

ReportSection VerdictSection(const ReportInput& input, const ScanSummary& summary) {
  ReportSection section{"verdict", "", {}, {}};
  const ScanSummary::PoseVerdict& verdict = summary.verdict;
  const std::string sentence = Sentence(input, verdict);
  const std::string next = NextCommand(input);
  const std::string style = StyleOf(verdict.verdict);
  section.numbers = {{"verdict", style},
                     {"sentence", sentence},
                     {"reasons", verdict.reasons},
                     {"advice", verdict.advice},
                     {"next_command", next}};
  HtmlWriter& out = section.html;
  out.Open("div", {{"class", "verdict " + style}});
  out.Element("b", style == "unknown" ? "no judgement" : style, {{"class", "grade"}});
  out.Element("p", sentence, {{"class", "sentence"}});
  WriteList("Why", verdict.reasons, &out);
  WriteList("What to photograph differently", verdict.advice, &out);
  const bool poses_hold = verdict.poses_hold || verdict.verdict.empty();
  if (!poses_hold && next == "gaussian_trainer") {
    out.Open("p").Text("Training waits, since wrong poses make a wrong model; ");
    out.Element("code", ScanCommand(input, {"--force", "1"})).Text(" goes on all the same.").Close();
  } else if (!next.empty()) {
    out.Open("p").Text("Not everything has run: next comes ").Element("code", next).Text(". ");
    out.Element("code", ScanCommand(input, {})).Text(" runs all that is missing.").Close();
  } else if (verdict.verdict == "good") {
    out.Element("p",
                "Nothing needs to be photographed again: look at the photos with warnings, if there are any, "
                "then at the mesh.");
  }
  for (const std::string& problem : input.problems) WriteMissing(problem, &out);
  out.Close();
  WriteTiles(KeyFigures(input, poses_hold), &out);
  return section;
}

}  // namespace s2gs
