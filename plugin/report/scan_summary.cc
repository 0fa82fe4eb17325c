#include "plugin/report/scan_summary.h"

#include <fmt/format.h>

#include <algorithm>
#include <fstream>
#include <nlohmann/json.hpp>
#include <optional>
#include <sstream>
#include <utility>

#include "mesh/surface/triangle_mesh.h"
#include "plugin/cli/console_reporter.h"
#include "plugin/plan/scan_plan.h"
#include "plugin/stage/json_file.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/scene/io/colmap_model.h"
#include "sfm_split/scene/io/turntable_file.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::json;

constexpr uint64_t kMaxJsonBytes = uint64_t{1} << 30;

void AddPlan(const Workspace& workspace, ScanSummary* summary) {
  PlanRequest request;
  request.workspace = workspace;
  request.forced = PlannedForced(workspace.Plan());
  Reporter silent;
  for (const PlanDecision& decision : MakeScanPlan(request, silent).decisions) {
    // The photos, which decide whether there are masks, are not looked at here.
    if (decision.state != PlanState::kLeftOut) continue;
    std::string why = decision.reason;
    if (!decision.measured.empty()) why += " (" + decision.measured + ")";
    summary->left_out.emplace_back(WhatOf(decision), why);
  }
}

void AddPoses(const Workspace& workspace, ScanSummary* summary) {
  if (Exists(workspace.ObjectModel())) {
    const ColmapModel model = ReadColmapModel(workspace.ObjectModel());
    summary->figures.emplace_back("photos with a pose", std::to_string(model.images.size()));
    summary->figures.emplace_back("points of the rotating part", std::to_string(model.points3D.size()));
  }
  if (Exists(workspace.StaticModel())) {
    const ColmapModel model = ReadColmapModel(workspace.StaticModel());
    summary->figures.emplace_back("points of the background", std::to_string(model.points3D.size()));
  }
  if (Exists(workspace.Turntable())) {
    const TurntableFile turntable = ReadTurntableFile(workspace.Turntable());
    summary->figures.emplace_back("stations", std::to_string(turntable.num_stations));
    summary->figures.emplace_back("scale against the background",
                                  turntable.scale_observable ? "observed" : "cannot be observed");
  }
}

// "0" where there is none: a fraction or 1e300 is no count.
std::string CountIn(const Json& entry, const char* key) {
  const auto found = entry.find(key);
  return std::to_string(found != entry.end() && found->is_number_integer() ? found->get<int64_t>() : 0);
}

void AddTraining(const Workspace& workspace, ScanSummary* summary) {
  std::ifstream log(workspace.Log());
  std::string line;
  Json last;
  Json held_out;
  while (std::getline(log, line)) {
    const Json entry = Json::parse(line, nullptr, false);
    if (!entry.is_object()) continue;
    last = entry;
    if (entry.value("event", "") == "held_out") held_out = entry;
  }
  if (last.is_object()) {
    summary->figures.emplace_back("training iterations", CountIn(last, "iteration"));
    summary->figures.emplace_back("Gaussians", CountIn(last, "count"));
  }
  if (held_out.is_object() && held_out.contains("psnr_db") && held_out["psnr_db"].is_number()) {
    summary->figures.emplace_back("PSNR of held-out photos",
                                  fmt::format("{:.2f} dB", held_out["psnr_db"].get<double>()));
  }
}

void AddMesh(const Workspace& workspace, ScanSummary* summary) {
  if (!Exists(workspace.TsdfMesh())) return;
  const TriangleMesh mesh = ReadPlyMesh(workspace.TsdfMesh());
  summary->figures.emplace_back("triangles of the mesh", std::to_string(mesh.triangles.size()));
}

void AddFiles(const Workspace& workspace, ScanSummary* summary) {
  const std::vector<std::pair<std::string, fs::path>> candidates = {
      {"mesh", workspace.TsdfMesh()},          {"masks", workspace.Masks()},
      {"Gaussians", workspace.PointCloud()},   {"picture", workspace.Overview()},
      {"training log", workspace.Log()},       {"rotating part", workspace.ObjectModel()},
      {"background", workspace.StaticModel()}, {"table", workspace.Turntable()},
      {"top view", workspace.TopView()},       {"report", workspace.ReportHtml()},
      {"its figures", workspace.ReportJson()},
  };
  for (const auto& [what, path] : candidates) {
    if (Exists(path)) summary->files.emplace_back(what, path);
  }
}

}  // namespace

ScanSummary::PoseVerdict ReadPoseVerdict(const Workspace& workspace) {
  ScanSummary::PoseVerdict result;
  const Json report = ReadJsonFile(workspace.ObjectDatabase().parent_path() / "turntable_mapper.json");
  if (!report.is_object() || !report.contains("verdict") || !report["verdict"].is_object()) return result;
  const Json& verdict = report["verdict"];
  const auto strings = [&](const char* key, std::vector<std::string>* out) {
    for (const Json& line : verdict.value(key, Json::array())) {
      if (line.is_string()) out->push_back(line.get<std::string>());
    }
  };
  if (verdict.contains("verdict") && verdict["verdict"].is_string()) result.verdict = verdict["verdict"];
  strings("reasons", &result.reasons);
  strings("advice", &result.advice);
  result.poses_hold = verdict.contains("poses_hold") && verdict["poses_hold"].is_boolean()
                          ? verdict["poses_hold"].get<bool>()
                          : result.verdict == "good";
  return result;
}

void CollectFigures(const Workspace& workspace, ScanSummary* summary) {
  summary->verdict = ReadPoseVerdict(workspace);
  for (const auto add : {AddPlan, AddPoses, AddTraining, AddMesh, AddFiles}) {
    try {
      add(workspace, summary);
    } catch (const UserError&) {
      continue;  // the step that owns the file has said what is wrong with it
    } catch (const Json::exception&) {
      continue;  // a log or a file of labels that somebody changed: what it says is left out
    }
  }
}

nlohmann::ordered_json SummaryToJson(const ScanSummary& summary) {
  nlohmann::ordered_json json;
  json["steps"] = nlohmann::ordered_json::array();
  for (const ScanSummary::Step& step : summary.steps) {
    json["steps"].push_back({{"command", step.command},
                             {"line", step.shell_line},
                             {"wall_seconds", step.wall_seconds},
                             {"cpu_seconds", step.cpu_seconds}});
  }
  json["stages"] = nlohmann::ordered_json::array();
  for (const ScanSummary::Stage& stage : summary.stages) {
    json["stages"].push_back(
        {{"name", stage.name}, {"run", stage.has_run}, {"reason", stage.reason}, {"seconds", stage.seconds}});
  }
  json["verdict"] = nullptr;
  if (!summary.verdict.verdict.empty()) {
    json["verdict"] = {{"verdict", summary.verdict.verdict},
                       {"reasons", summary.verdict.reasons},
                       {"advice", summary.verdict.advice}};
  }
  json["left_out"] = nlohmann::ordered_json::array();
  for (const auto& [what, why] : summary.left_out) json["left_out"].push_back({{"what", what}, {"why", why}});
  json["figures"] = nlohmann::ordered_json::object();
  for (const auto& [name, value] : summary.figures) json["figures"][name] = value;
  json["files"] = nlohmann::ordered_json::object();
  for (const auto& [what, where] : summary.files) json["files"][what] = where.string();
  return json;
}

void WriteScanRecord(const fs::path& path, const ScanSummary& summary) {
  const ScanSummary before = ReadScanRecord(path);
  ScanSummary record;
  record.stages = summary.stages;
  for (ScanSummary::Stage& stage : record.stages) {
    const auto then = std::find_if(before.stages.begin(), before.stages.end(),
                                   [&](const ScanSummary::Stage& s) { return s.name == stage.name; });
    if (!stage.has_run && then != before.stages.end()) stage = *then;
  }
  for (ScanSummary::Step step : summary.steps) {
    const auto then = std::find_if(before.steps.begin(), before.steps.end(), [&](const ScanSummary::Step& s) {
      return s.shell_line == step.shell_line;
    });
    if (!step.has_run && then != before.steps.end()) step = *then;
    record.steps.push_back(step);
  }
  const std::string text =
      SummaryToJson(record).dump(1, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
  if (Exists(path) && ReadWholeFile(path, kMaxJsonBytes) == text) return;
  WriteFileAtomically(path, [&](std::ostream& out) { out << text; });
}

ScanSummary ReadScanRecord(const fs::path& path) {
  ScanSummary record;
  const Json json = ReadJsonFile(path);
  try {
    if (!json.is_object()) return {};
    for (const Json& step : json.at("steps")) {
      record.steps.push_back({step.at("command").get<std::string>(), "", step.at("line").get<std::string>(),
                              step.at("wall_seconds").get<double>(), step.at("cpu_seconds").get<double>()});
    }
    for (const Json& stage : json.at("stages")) {
      record.stages.push_back({stage.at("name").get<std::string>(), stage.at("run").get<bool>(),
                               stage.at("reason").get<std::string>(), stage.at("seconds").get<double>()});
    }
  } catch (const Json::exception&) {
    return {};
  }
  return record;
}

void PrintScanSummary(const ScanSummary& summary, std::ostream& out) {
  const auto line = [&](const std::string& name, const std::string& value) {
    // A name that fills its column has the value on a line of its own.
    const bool fits = name.size() <= 30;
    if (!fits) out << "  " << name << "\n";
    out << fmt::format("  {:<32}{}\n", fits ? name : "", value);
  };
  const auto stages = [&](bool have_run, const std::string& title) {
    std::string shown = title;
    for (const ScanSummary::Stage& stage : summary.stages) {
      if (stage.has_run != have_run) continue;
      out << std::exchange(shown, "");
      line(stage.name, fmt::format("{:<9}{}", FormatDuration(stage.seconds), stage.reason));
    }
  };
  stages(true, "\nWhat ran, its time, and why\n");
  stages(false, "\nWhat was skipped, its time back then, and why\n");
  double total = 0;
  for (const ScanSummary::Step& step : summary.steps) total += step.wall_seconds;
  line("this run", FormatDuration(total));
  if (!summary.verdict.verdict.empty()) {
    out << "\nThe poses are " << summary.verdict.verdict << "\n";
    for (const std::string& reason : summary.verdict.reasons) out << "  " << reason << "\n";
    if (!summary.verdict.advice.empty()) out << "What to photograph differently\n";
    for (const std::string& advice : summary.verdict.advice) out << "  " << advice << "\n";
  }
  if (!summary.left_out.empty()) out << "\nWhat was left out, and why\n";
  for (const auto& [what, why] : summary.left_out) line(what, why);
  out << "\nWhat came out\n";
  for (const auto& [name, value] : summary.figures) line(name, value);
  out << "\nWhere it is\n";
  for (const auto& [what, where] : summary.files) line(what, where.string());
  out << std::flush;
}

}  // namespace s2gs
