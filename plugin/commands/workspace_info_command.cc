#include "plugin/commands/workspace_info_command.h"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <string>
#include <system_error>
#include <vector>

#include "plugin/cli/console_reporter.h"
#include "plugin/stage/fingerprint.h"
#include "plugin/stage/stage.h"
#include "plugin/stage/workspace.h"
#include "sfm_split/base/error.h"

namespace s2gs {
namespace {

std::string FormatBytes(uint64_t bytes) {
  if (bytes < 1000) return fmt::format("{} B", bytes);
  auto value = static_cast<double>(bytes);
  const char* unit = "";
  for (const char* next : {"kB", "MB", "GB", "TB"}) {
    if (value < 999.95) break;
    value /= 1000;
    unit = next;
  }
  return fmt::format("{:.1f} {}", value, unit);
}

std::string DescribeState(const StageStatus& status) {
  switch (status.state) {
    case StageState::kDone:
      return fmt::format("done     {}, took {}, s2gs {}", status.stamp->finished,
                         FormatDuration(status.stamp->seconds), status.stamp->program_version);
    case StageState::kStale:
      return "stale    " + status.reason;
    case StageState::kForeign:
      return "present  its files are there, but were not made by this program";
    case StageState::kMissing:
      return "missing";
  }
  return "";
}

}  // namespace

void RunWorkspaceInfo(CommandContext& context) {
  std::filesystem::path workspace_path;
  Options& options = context.Declare(
      "Lists the stages of a workspace: which are done, which are not and why. Then its files with their "
      "sizes.",
      "--workspace_path scan");
  options.Add("workspace_path", &workspace_path, "the workspace, a folder").Required();
  Reporter& reporter = context.Parse();

  const Workspace workspace{workspace_path};
  std::error_code ec;
  if (!std::filesystem::is_directory(workspace.root, ec)) {
    throw UserError(workspace.root, "no such folder", "Check --workspace_path");
  }
  const std::vector<StageStatus> stages = CheckStages(workspace, reporter);
  size_t width = 0;
  for (const StageStatus& status : stages) width = std::max(width, status.name.size());
  context.out() << "Stages:\n";
  for (const StageStatus& status : stages) {
    context.out() << fmt::format("  {:{}}  {}\n", status.name, width, DescribeState(status));
  }

  std::vector<std::string> lines;
  for (const auto& [path, meaning] : WorkspaceContents(workspace)) {
    const Fingerprint state = TakeState(path);
    if (!state.exists) continue;
    const bool is_folder = std::filesystem::is_directory(path, ec);
    const std::string name = path.lexically_relative(workspace.root).string() + (is_folder ? "/" : "");
    const std::string count = is_folder ? fmt::format("{} files", state.num_files) : "";
    lines.push_back(
        fmt::format("  {:28} {:>10} {:>12}  {}\n", name, FormatBytes(state.num_bytes), count, meaning));
  }
  context.out() << "\nFiles:\n";
  for (const std::string& line : lines) context.out() << line;
  if (lines.empty()) context.out() << "  none yet\n";
}

}  // namespace s2gs
