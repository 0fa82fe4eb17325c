#include "plugin/report/scan_report.h"

#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "plugin/report/page_head.h"
#include "plugin/report/page_parts.h"
#include "plugin/report/sections.h"
#include "sfm_split/base/file_io.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

std::string TitleOf(const Workspace& workspace) {
  std::error_code ec;
  const fs::path root = fs::weakly_canonical(workspace.root, ec);
  const std::string name = (ec ? workspace.root : root).filename().string();
  return name.empty() ? "scan" : name;
}

std::string Page(const std::string& title, const std::vector<ReportSection>& sections) {
  HtmlWriter out;
  OpenPage(title, "Scan report", &out);
  out.Open("nav");
  for (const ReportSection& section : sections) {
    if (!section.title.empty()) out.Element("a", section.title, {{"href", "#" + section.id}});
  }
  out.Close().Close();
  out.Open("main");
  for (const ReportSection& section : sections) {
    out.Open("section", {{"id", section.id}});
    if (!section.title.empty()) out.Element("h2", section.title);
    out.Append(section.html.html());
    out.Close();
  }
  out.Close();
  for (const char* script : {kPageScript, kViewerScript}) out.Open("script").Append(script).Close();
  out.Close().Close();
  return out.html();
}

}  // namespace

void WriteScanReport(const Workspace& workspace, const fs::path& image_path, Reporter& reporter) {
  const ReportInput input = ReadReportInput(workspace, image_path, reporter);
  ScanSummary summary = ReadScanRecord(workspace.ScanRecord());
  CollectFigures(workspace, &summary);
  std::vector<ReportSection> sections;
  const auto add = [&](const char* id, const char* title, const std::function<ReportSection()>& make) {
    try {
      sections.push_back(make());
    } catch (const nlohmann::json::exception& error) {
      // A file that somebody changed: the other parts do not depend on it.
      const std::string problem = std::string("The part \"") + id + "\" of the report is left out, because " +
                                  workspace.TurntableMapper().string() + " or " + workspace.Log().string() +
                                  " is damaged (" + error.what() + "). Delete it and run its stage again";
      reporter.Warn(problem);
      ReportSection& section = sections.emplace_back(ReportSection{id, title, {}, {}});
      section.numbers = nlohmann::ordered_json::object();
      WriteMissing(problem, &section.html);
    }
  };
  add("verdict", "", [&] { return VerdictSection(input, summary); });
  add("stages", "Stages and time", [&] { return StagesSection(input, summary); });
  add("photos", "Photos", [&] { return PhotosSection(input, reporter); });
  add("table", "Table and stations", [&] { return TableSection(input); });
  add("residuals", "Residuals and matches", [&] { return ResidualsSection(input); });
  add("geometry", "Camera and scale", [&] { return GeometrySection(input); });
  add("pictures", "Split and model against the photos", [&] { return PicturesSection(input, reporter); });
  add("mesh", "Mesh", [&] { return MeshSection(input, reporter); });
  add("curves", "Error against time", [&] { return CurvesSection(input); });
  add("provenance", "How to make it again", [&] { return ProvenanceSection(input, summary, reporter); });

  nlohmann::ordered_json json = SummaryToJson(summary);
  for (const ReportSection& section : sections) json["report"][section.id] = section.numbers;
  const std::string page = Page(TitleOf(workspace), sections);
  // Names of files may hold any bytes.
  const std::string text = json.dump(1, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
  WriteFilesTogether({{workspace.ReportHtml(), [&](std::ostream& out) { out << page; }},
                      {workspace.ReportJson(), [&](std::ostream& out) { out << text; }}});
}

}  // namespace s2gs
