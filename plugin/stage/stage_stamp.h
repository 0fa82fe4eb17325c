#pragma once

#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "plugin/stage/fingerprint.h"
#include "plugin/stage/workspace.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

/// A file or folder of a stamp, with its fingerprint at the time.
struct StampedPath {
  std::string path;  ///< as StampPath() gives it.
  Fingerprint fingerprint;
};

/// What is kept of a finished stage, as JSON in W/s2gs/stages/NAME.json.
struct StageStamp {
  std::string run_id;  ///< another one every time the stage runs.
  std::string program_version;
  std::string finished;  ///< UTC, ISO 8601.
  double seconds = 0;    ///< that the stage took.
  std::string reason;    ///< why it ran; "" in stamps of older versions.
  std::map<std::string, std::string> options;
  std::vector<StampedPath> inputs;              ///< before the stage ran.
  std::vector<StampedPath> outputs;             ///< after it; without contents.
  std::map<std::string, std::string> upstream;  ///< name and run_id of the stages before; "" for none.
};

/// Now, UTC, ISO 8601, to the second.
std::string UtcNow();

/// A path as stamps keep it: relative to the workspace when inside it, so that a workspace can be moved; else
/// absolute. `workspace.root / StampPath(workspace, path)` is the path again.
std::string StampPath(const Workspace& workspace, const std::filesystem::path& path);

/// The stamp of a stage; nothing when there is none, or a damaged one, which is warned about.
std::optional<StageStamp> ReadStageStamp(const Workspace& workspace, const std::string& name,
                                         Reporter& reporter);

/// Throws UserError when it cannot be written.
void WriteStageStamp(const Workspace& workspace, const std::string& name, const StageStamp& stamp);

/// Throws UserError when it cannot be removed.
void RemoveStageStamp(const Workspace& workspace, const std::string& name);

}  // namespace s2gs
