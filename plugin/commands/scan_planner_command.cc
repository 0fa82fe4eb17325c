#include "plugin/commands/scan_planner_command.h"

#include <filesystem>
#include <string>
#include <system_error>
#include <vector>

#include "plugin/plan/plan_parts.h"
#include "plugin/plan/scan_plan.h"
#include "plugin/stage/workspace.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/resolved_path.h"

namespace s2gs {

void RunScanPlanner(CommandContext& context) {
  namespace fs = std::filesystem;
  fs::path workspace_path;
  fs::path image_path;
  fs::path mask_path;
  fs::path output_path;
  std::vector<std::string> force;
  Options& options = context.Declare(
      "Shows what a scan of these photos, or of this workspace as it stands, will do: each stage, and each "
      "part "
      "that some scenes do not need, with what was measured, the threshold, the reason and what leaving it "
      "out "
      "saves. Nothing is run: what only a stage can measure is listed as such until that stage has run. "
      "Written "
      "as s2gs/plan.json when there is a workspace.",
      "--workspace_path scan --image_path photos");
  options.Add("workspace_path", &workspace_path, "the workspace; empty: there is none yet");
  options.Add("image_path", &image_path, "the photos; empty: images in the workspace, if they are there");
  options.Add("mask_path", &mask_path, "masks of the rotating part, if the scan is to be given any");
  options.Add("force", &force, "parts or stages that the scan is to run whatever is measured");
  options.Add("output_path", &output_path, "plan.json; empty: s2gs/plan.json in the workspace");
  Reporter& reporter = context.Parse();
  if (!output_path.empty() && output_path.extension() != ".json") {
    throw UserError(output_path, "is no name for a plan", "Choose one that ends in .json");
  }
  if (workspace_path.empty() && image_path.empty()) {
    throw CommandLineError("give --workspace_path, --image_path or both.");
  }
  std::error_code ec;
  for (const auto& [path, name] :
       {std::pair(workspace_path, "--workspace_path"), std::pair(image_path, "--image_path"),
        std::pair(mask_path, "--mask_path")}) {
    if (!path.empty() && !fs::is_directory(path, ec)) {
      throw UserError(path, "there is no such folder", std::string("Check ") + name);
    }
  }
  PlanRequest request;
  request.workspace = Workspace{workspace_path};
  request.image_path = image_path;
  if (image_path.empty() && fs::is_directory(request.workspace.Images(), ec)) {
    request.image_path = request.workspace.Images();
  }
  request.has_masks = !mask_path.empty();
  request.forced = ForcedParts(force);
  const ScanPlan plan = MakeScanPlan(request, reporter);
  PrintScanPlan(plan, context.out());
  if (output_path.empty() && !workspace_path.empty()) {
    RequireNoLinkOut(request.workspace.root, request.workspace.Own());
    RequireNoLinkOut(request.workspace.root, request.workspace.Plan());
    CreateFolder(request.workspace.Own());
    output_path = request.workspace.Plan();
  }
  if (output_path.empty()) return;
  WriteScanPlan(output_path, plan);
  context.out() << "\nwritten            " << output_path.string() << '\n';
}

}  // namespace s2gs
