#include "plugin/commands/report_command.h"

#include <fmt/format.h>

#include <filesystem>
#include <string>

#include "plugin/report/scan_report.h"
#include "plugin/stage/stage.h"
#include "plugin/stage/workspace.h"

namespace s2gs {

void RunReport(CommandContext& context) {
  std::filesystem::path workspace_path;
  std::filesystem::path image_path;
  Options& options = context.Declare(
      "Makes report.html, one file that opens without a network, and report.json, the same numbers, from "
      "whatever "
      "a workspace holds so far: how good the scan is and what to do next, stages and times, every photo, "
      "the "
      "table, residuals, camera, model against photos, the mesh, error against time, and how to make it all "
      "again. Skipped when nothing has changed.",
      "--workspace_path scan");
  options.Add("workspace_path", &workspace_path, "the workspace").Required();
  options.Add("image_path", &image_path,
              "the photos; empty: where the stages found them, else dense/0/images");
  Reporter& reporter = context.Parse();

  const Workspace workspace{workspace_path};
  StageRunner runner(workspace, reporter);
  Stage stage;
  stage.name = "report";
  stage.inputs = {workspace.SplitLabels(), workspace.SplitOverlays(), workspace.TurntableMapper(),
                  workspace.ObjectModel(), workspace.StaticModel(),   workspace.Turntable(),
                  workspace.Masks(),       workspace.Log(),           workspace.Overview(),
                  workspace.TsdfMesh(),    workspace.ScanRecord(),    workspace.MeshLog()};
  if (!image_path.empty()) stage.inputs.push_back(image_path);
  stage.outputs = {workspace.ReportHtml(), workspace.ReportJson()};
  for (const StandardStage& before : StandardStages(workspace)) {
    if (before.name != stage.name) stage.depends_on.push_back(before.name);
  }
  if (!runner.Run(stage, [&] { WriteScanReport(workspace, image_path, reporter); })) {
    context.out() << fmt::format("up to date       {}\n", workspace.ReportHtml().string());
    return;
  }
  context.out() << fmt::format("written          {}\n", workspace.ReportHtml().string());
}

}  // namespace s2gs
