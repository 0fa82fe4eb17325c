#include "plugin/workspace_info_command.h"

#include <filesystem>

namespace s2gs {

void RunWorkspaceInfo(CommandContext& context) {
  std::filesystem::path workspace_path;
  Options& options = context.Declare(
      "Lists the stages of a workspace: which are done, which are not and why. Then its files with their "
      "sizes.",
      "--workspace_path scan");
  options.Add("workspace_path", &workspace_path, "the workspace, a folder").Required();
  context.Parse();
}

}  // namespace s2gs
