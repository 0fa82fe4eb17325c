#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "plugin/cli/options.h"
#include "plugin/stage/stage_stamp.h"
#include "plugin/stage/workspace.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

/// The reason for which a stage runs for the first time.
inline constexpr char kNotDoneYet[] = "not done yet";

/// One step of the pipeline: what it reads, what it depends on, and what it promises to write.
struct Stage {
  std::string name;  ///< letters, digits and '_'.
  /// Files or folders that it reads and does not change; their contents count. They need not exist.
  std::vector<std::filesystem::path> inputs;
  std::map<std::string, std::string> options;  ///< those that change its result: Options::Values().
  /// Files or folders that exist when it is done. Later stages may change them.
  std::vector<std::filesystem::path> outputs;
  std::vector<std::string> depends_on;  ///< stages that come before: when one runs again, so does this one.
  /// Besides its outputs, what it may write or remove in the workspace.
  std::vector<std::filesystem::path> also_writes = {};
};

enum class StageState {
  kDone,
  kStale,    ///< it ran, but something changed since.
  kMissing,  ///< no stamp and no outputs.
  kForeign,  ///< its outputs are there, but no stamp says that s2gs made them.
};

struct StageStatus {
  std::string name;
  StageState state = StageState::kMissing;
  std::string reason;  ///< why it is stale.
  std::optional<StageStamp> stamp;
};

/// Options::Values() without those named: paths, whose contents count as inputs, and what results do not
/// depend on, like the number of threads.
std::map<std::string, std::string> ValuesWithout(const Options& options,
                                                 const std::vector<std::string>& left_out);

/// The standard stages in order, then others that left a stamp, each judged by its stamp. Changed options do
/// not show here: only the command that runs the stage knows them.
std::vector<StageStatus> CheckStages(const Workspace& workspace, Reporter& reporter);

/// Runs the stages of one command in a workspace, which it locks, after removing what killed runs left.
class StageRunner {
 public:
  /// Throws UserError when the workspace is no folder, or another s2gs works in it.
  StageRunner(Workspace workspace, Reporter& reporter);

  /// Runs `work` unless the stage is done, with the same options and inputs and after the same runs of the
  /// stages that it depends on; says which and why. Begins nothing that would be written through a symbolic
  /// link out of the workspace, but throws UserError. When `work` throws, or the program is killed, the stage
  /// is not done and runs again next time. Returns whether it ran. Throws UserError when an output is missing
  /// afterwards.
  /// `work` may run another stage, whose seconds do not count as its own where that is done at its end.
  bool Run(const Stage& stage, const std::function<void()>& work);

 private:
  // Writes a stamp whose inputs look different but are not.
  void Refresh(const std::string& name, const StageStamp& stamp);

  // Seconds of the stages that began after a time and are done.
  double SecondsOfStagesSince(double begin) const;

  Workspace workspace_;
  Reporter& reporter_;
  WorkspaceLock lock_;
  std::map<std::string, std::pair<double, double>> ran_;  // by name: when they began, and their seconds
};

}  // namespace s2gs
