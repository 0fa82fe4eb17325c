#include <fmt/format.h>

#include <system_error>

#include "plugin/cli/version.h"
#include "plugin/report/sections.h"
#include "plugin/stage/fingerprint.h"
#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

void WriteLines(const ScanSummary& summary, ReportSection* section) {
  HtmlWriter& out = section->html;
  out.Element("h3", "Command lines");
  nlohmann::ordered_json& lines = section->numbers["command_lines"] = nlohmann::ordered_json::array();
  if (summary.steps.empty()) {
    WriteMissing("The scanner recorded none: the commands were run by hand, with the options below.", &out);
    return;
  }
  std::string text;
  for (const ScanSummary::Step& step : summary.steps) {
    text += step.shell_line + "\n";
    lines.push_back({{"command", step.command},
                     {"line", step.shell_line},
                     {"wall_seconds", step.wall_seconds},
                     {"cpu_seconds", step.cpu_seconds}});
  }
  out.Element("pre", text);
}

void WriteOptions(const ReportInput& input, ReportSection* section) {
  HtmlWriter& out = section->html;
  out.Element("h3", "Options of every stage");
  nlohmann::ordered_json& stages = section->numbers["stages"] = nlohmann::ordered_json::array();
  for (const StageStatus& stage : input.stages) {
    if (!stage.stamp || stage.name == "report") continue;
    const StageStamp& stamp = *stage.stamp;
    out.Open("details").Element("summary", fmt::format("{}, s2gs {}, finished {}", stage.name,
                                                       stamp.program_version, stamp.finished));
    out.Open("div", {{"class", "scroll"}}).Open("table", {{"class", "wide"}});
    for (const auto& [name, value] : stamp.options) WriteRow({name, value}, &out);
    for (const StampedPath& path : stamp.inputs) {
      WriteRow({"reads " + path.path,
                fmt::format("XXH3 {}, {}, {} bytes", path.fingerprint.content,
                            Count(path.fingerprint.num_files, "file"), path.fingerprint.num_bytes)},
               &out);
    }
    out.Close().Close().Close();
    nlohmann::ordered_json inputs = nlohmann::ordered_json::array();
    for (const StampedPath& path : stamp.inputs) {
      inputs.push_back(
          {{"path", path.path}, {"bytes", path.fingerprint.num_bytes}, {"xxh3", path.fingerprint.content}});
    }
    stages.push_back({{"name", stage.name},
                      {"version", stamp.program_version},
                      {"finished", stamp.finished},
                      {"options", stamp.options},
                      {"inputs", inputs}});
  }
}

void WriteHashes(const ReportInput& input, Reporter& reporter, ReportSection* section) {
  HtmlWriter& out = section->html;
  const Workspace& w = input.workspace;
  nlohmann::ordered_json& files = section->numbers["files"] = nlohmann::ordered_json::array();
  out.Element("h3", "What came out");
  out.Open("div", {{"class", "scroll"}}).Open("table", {{"class", "wide stacked"}});
  const std::vector<std::string> head = {"file or folder", "bytes", "XXH3 of names and contents"};
  WriteRow(head, &out, "th");
  for (const fs::path& path :
       {w.Turntable(), w.ObjectModel(), w.StaticModel(), w.PointCloud(), w.Masks(), w.TsdfMesh()}) {
    std::error_code ec;
    if (!fs::exists(path, ec)) continue;
    try {
      const Fingerprint fingerprint = TakeFingerprint(path, reporter);
      const std::string name = path.lexically_relative(w.root).generic_string();
      WriteHeadedRow(head, {name, std::to_string(fingerprint.num_bytes), fingerprint.content}, &out);
      files.push_back({{"path", name}, {"bytes", fingerprint.num_bytes}, {"xxh3", fingerprint.content}});
    } catch (const UserError& error) {
      reporter.Warn(error.what());
    }
  }
  out.Close().Close();
}

}  // namespace

ReportSection ProvenanceSection(const ReportInput& input, const ScanSummary& summary, Reporter& reporter) {
  ReportSection section{"provenance", "How to make it again", {}, {}};
  section.numbers = {{"program", VersionText()}};
  section.html.Element("p", "Made by " + VersionText() + ".");
  WriteLines(summary, &section);
  WriteOptions(input, &section);
  WriteHashes(input, reporter, &section);
  return section;
}

}  // namespace s2gs
