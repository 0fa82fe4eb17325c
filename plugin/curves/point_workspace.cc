#include "plugin/curves/point_workspace.h"

#include <algorithm>
#include <set>
#include <system_error>
#include <vector>

#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/resolved_path.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

void ThrowIf(const std::error_code& ec, const fs::path& path, const char* what) {
  if (ec)
    throw UserError(path, std::string(what) + ": " + ec.message(), "Check the disk and its permissions");
}

// A new name for a file, or a copy of it on another file system. Databases are opened for writing.
void LinkOrCopy(const fs::path& from, const fs::path& to) {
  std::error_code ec;
  if (from.extension() != ".db") {
    fs::create_hard_link(from, to, ec);
    if (!ec) return;
  }
  fs::copy_file(from, to, fs::copy_options::overwrite_existing, ec);
  ThrowIf(ec, to, "cannot be copied");
}

// Relative to the workspace: what no run needs, and what the stages from `from` on make. By their names:
// photos may lie behind a link.
std::set<fs::path> LeftOut(const Workspace& base, const std::string& from) {
  const auto within = [&](const fs::path& path) { return path.lexically_relative(base.root); };
  std::set<fs::path> left_out = {within(base.Images()), "work_precision", "report.json", "report.html",
                                 within(base.LockFile())};
  bool is_later = false;
  for (const StandardStage& stage : StandardStages(base)) {
    is_later = is_later || stage.name == from;
    if (!is_later) continue;
    left_out.insert(within(base.StageStamp(stage.name)));
    for (const fs::path& output : stage.outputs) left_out.insert(within(output));
  }
  S2GS_INVARIANT(is_later);
  if (left_out.count(within(base.PointCloud())) > 0) {
    left_out.insert(within(base.Checkpoints()));
    left_out.insert(within(base.Log()));
  }
  return left_out;
}

}  // namespace

void MakePointWorkspace(const Workspace& base, const std::string& from, const Workspace& point) {
  std::error_code ec;
  fs::remove_all(point.root, ec);
  ThrowIf(ec, point.root, "cannot be removed");
  CreateFolder(point.root);
  const std::set<fs::path> left_out = LeftOut(base, from);
  fs::recursive_directory_iterator entry(base.root, fs::directory_options::none, ec);
  ThrowIf(ec, base.root, "cannot be read");
  for (; entry != fs::recursive_directory_iterator(); entry.increment(ec)) {
    const fs::path relative = entry->path().lexically_relative(base.root);
    if (left_out.count(relative) > 0) {
      entry.disable_recursion_pending();
      continue;
    }
    if (entry->is_directory()) {
      CreateFolder(point.root / relative);
    } else if (entry->is_regular_file()) {
      LinkOrCopy(entry->path(), point.root / relative);
    }
  }
  ThrowIf(ec, base.root, "cannot be read");
  if (fs::exists(base.Images(), ec)) {
    fs::create_directory_symlink(fs::canonical(base.Images()), point.Images(), ec);
    ThrowIf(ec, point.Images(), "cannot be made");
  }
}

void ThinPointWorkspace(const Workspace& point) {
  const std::vector<fs::path> kept = {point.ObjectModel(),   point.StaticModel(), point.Turntable(),
                                      point.TsdfMesh(),      point.Log(),         point.root / "point.json",
                                      point.root / "run.log"};
  std::vector<fs::path> doomed;
  std::error_code ec;
  for (const fs::directory_entry& entry : fs::recursive_directory_iterator(point.root, ec)) {
    const bool stays = std::any_of(kept.begin(), kept.end(), [&](const fs::path& path) {
      return IsWithin(entry.path(), path) || IsWithin(path, entry.path());
    });
    if (!stays) doomed.push_back(entry.path());
  }
  for (const fs::path& path : doomed) fs::remove_all(path, ec);
}

}  // namespace s2gs
