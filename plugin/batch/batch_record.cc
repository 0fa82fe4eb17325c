#include "plugin/batch/batch_record.h"

#include <fmt/format.h>

#include <cstring>
#include <nlohmann/json.hpp>

#include "plugin/cli/command.h"
#include "plugin/stage/json_file.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/resolved_path.h"

namespace s2gs {
namespace {

std::string Joined(const std::vector<std::string>& sentences) {
  std::string text;
  for (const std::string& sentence : sentences) text += (text.empty() ? "" : "; ") + sentence;
  return text;
}

std::string OrElse(const std::string& text, const std::string& other) { return text.empty() ? other : text; }

}  // namespace

std::string BatchStateName(BatchState state) {
  switch (state) {
    case BatchState::kWaiting:
      return "waiting";
    case BatchState::kRunning:
      return "running";
    case BatchState::kDone:
      return "done";
    case BatchState::kDoubtful:
      return "doubtful";
    case BatchState::kFailed:
      return "failed";
    case BatchState::kWrong:
      return "wrong";
  }
  return "";
}

BatchOutcome JudgeRecord(const BatchRecord& record, const ScanSummary::PoseVerdict& poses) {
  switch (record.exit_code) {
    case kExitDone:
      if (poses.verdict == "failed") return {BatchState::kFailed, Joined(poses.reasons)};
      if (poses.verdict == "doubtful") return {BatchState::kDoubtful, Joined(poses.reasons)};
      return {BatchState::kDone, ""};
    case kExitDoubtful:
      return {poses.verdict == "failed" ? BatchState::kFailed : BatchState::kDoubtful,
              OrElse(Joined(poses.reasons), record.message)};
    case kExitInterrupted:
      return {BatchState::kWaiting, "was stopped: goes on where it was"};
    default:
      break;
  }
  if (record.signal != 0) {
    return {BatchState::kFailed, fmt::format("ended by signal {} ({}). See s2gs/batch.log", record.signal,
                                             ::strsignal(record.signal))};
  }
  return {BatchState::kFailed,
          OrElse(record.message, fmt::format("exit code {}. See s2gs/batch.log", record.exit_code))};
}

std::optional<BatchRecord> ReadBatchRecord(const Workspace& workspace) {
  const nlohmann::json json = ReadJsonFile(workspace.BatchRecord());
  try {
    BatchRecord record;
    json.at("exit_code").get_to(record.exit_code);
    json.at("signal").get_to(record.signal);
    json.at("message").get_to(record.message);
    json.at("finished").get_to(record.finished);
    json.at("wall_seconds").get_to(record.wall_seconds);
    json.at("cpu_seconds").get_to(record.cpu_seconds);
    json.at("arguments").get_to(record.arguments);
    return record;
  } catch (const nlohmann::json::exception&) {
    return std::nullopt;
  }
}

void WriteBatchRecord(const Workspace& workspace, const BatchRecord& record) {
  RequireNoLinkOut(workspace.root, workspace.BatchRecord());
  CreateFolder(workspace.Own());
  const nlohmann::ordered_json json = {{"version", 1},
                                       {"exit_code", record.exit_code},
                                       {"signal", record.signal},
                                       {"message", record.message},
                                       {"finished", record.finished},
                                       {"wall_seconds", record.wall_seconds},
                                       {"cpu_seconds", record.cpu_seconds},
                                       {"arguments", record.arguments}};
  const std::string text = json.dump(1, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
  WriteFileAtomically(workspace.BatchRecord(), [&](std::ostream& out) { out << text; });
}

BatchOutcome LookAtObject(const Workspace& workspace) {
  const std::optional<std::string> owner = OwnerOfLock(workspace.ScanLockFile());
  if (owner) return {BatchState::kRunning, owner->empty() ? "in another process" : "in process " + *owner};
  const std::optional<BatchRecord> record = ReadBatchRecord(workspace);
  if (!record) return {BatchState::kWaiting, ""};
  return JudgeRecord(*record, ReadPoseVerdict(workspace));
}

}  // namespace s2gs
