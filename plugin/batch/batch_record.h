#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "plugin/colmap/child_process.h"
#include "plugin/report/scan_summary.h"
#include "plugin/stage/workspace.h"

namespace s2gs {

enum class BatchState {
  kWaiting,   ///< has not been run, or not to its end.
  kRunning,   ///< a process works on it.
  kDone,      ///< all that was asked for is there, and the poses are good.
  kDoubtful,  ///< the poses are doubtful: what was asked for may be there or not.
  kFailed,
  kWrong,  ///< its row in the list.
};
std::string BatchStateName(BatchState state);

/// How the last run of an object's scan ended: s2gs/batch.json in its workspace.
struct BatchRecord {
  int exit_code = -1;    ///< of automatic_scanner; -1 when a signal ended it.
  int signal = 0;        ///< that ended it; 0: none.
  std::string message;   ///< what it said was wrong; empty: nothing.
  std::string finished;  ///< UTC, ISO 8601.
  double wall_seconds = 0;
  double cpu_seconds = 0;
  std::vector<std::string> arguments;  ///< of automatic_scanner.
};

/// Where an object stands and why.
struct BatchOutcome {
  BatchState state = BatchState::kWaiting;
  std::string why;
};

/// Judges a run by its exit code and by what the report says of the poses.
BatchOutcome JudgeRecord(const BatchRecord& record, const ScanSummary::PoseVerdict& poses);

/// Nothing where there is none, or a damaged one.
std::optional<BatchRecord> ReadBatchRecord(const Workspace& workspace);

/// Throws UserError when it cannot be written, or would be written out of the workspace.
void WriteBatchRecord(const Workspace& workspace, const BatchRecord& record);

/// Where an object stands, by its record and by who works in its workspace now.
BatchOutcome LookAtObject(const Workspace& workspace);

}  // namespace s2gs
