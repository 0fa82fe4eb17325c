#include "plugin/stage/stage.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <random>
#include <system_error>
#include <utility>

#include "plugin/cli/console_reporter.h"
#include "plugin/cli/version.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/resolved_path.h"
#include "sfm_split/base/stopwatch.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

// Two runs never share one, whatever the clock does.
std::string NewRunId() {
  std::random_device random;
  return fmt::format("{:08x}{:08x}", random(), random());
}

// Each of the following says why a stage is stale, or "" when it is not.

std::string OptionsReason(const std::map<std::string, std::string>& now,
                          const std::map<std::string, std::string>& before) {
  for (const auto& [name, value] : now) {
    const auto old = before.find(name);
    if (old == before.end()) return "option " + name + " is new";
    if (old->second != value)
      return fmt::format("option {} changed from \"{}\" to \"{}\"", name, old->second, value);
  }
  for (const auto& [name, value] : before) {
    if (now.count(name) == 0) return "option " + name + " is gone";
  }
  return "";
}

// Another version may compute otherwise from the same.
std::string VersionReason(const StageStamp& stamp) {
  if (stamp.program_version == Version()) return "";
  return fmt::format("it was made by s2gs {}, this is {}", stamp.program_version, Version());
}

std::string UpstreamReason(const Workspace& workspace, const std::map<std::string, std::string>& upstream,
                           Reporter& reporter) {
  for (const auto& [name, run_id] : upstream) {
    const std::optional<StageStamp> stamp = ReadStageStamp(workspace, name, reporter);
    if ((stamp.has_value() ? stamp->run_id : "") == run_id) continue;
    return name + (stamp.has_value() ? " ran again" : " is not done");
  }
  return "";
}

// Brings the states of inputs whose content is the same up to date, so that they need not be read next time.
std::string InputsReason(const Workspace& workspace, std::vector<StampedPath>* inputs,
                         const Reporter& reporter) {
  for (auto& [path, known] : *inputs) {
    const Fingerprint now = RefreshFingerprint(workspace.root / path, known, reporter);
    if (now.exists != known.exists) return path + (now.exists ? " appeared" : " is gone");
    if (now.num_files != known.num_files) {
      return fmt::format("{} has {} files, not {}", path, now.num_files, known.num_files);
    }
    if (now.content != known.content) return path + " changed";
    known = now;
  }
  return "";
}

std::string OutputsReason(const Workspace& workspace, const std::vector<StampedPath>& outputs) {
  for (const auto& [path, known] : outputs) {
    const Fingerprint now = TakeState(workspace.root / path);
    if (!now.exists) return path + " is missing";
    if (now.num_files < known.num_files) {
      return fmt::format("{} of the {} files of {} are missing", known.num_files - now.num_files,
                         known.num_files, path);
    }
    if (now.num_bytes == 0 && known.num_bytes > 0) return path + " is empty";
  }
  return "";
}

std::vector<std::string> StampPaths(const Workspace& workspace, const std::vector<fs::path>& paths) {
  std::vector<std::string> result;
  result.reserve(paths.size());
  for (const fs::path& path : paths) result.push_back(StampPath(workspace, path));
  return result;
}

bool AreSame(const std::vector<std::string>& paths, const std::vector<StampedPath>& stamped) {
  return std::equal(paths.begin(), paths.end(), stamped.begin(), stamped.end(),
                    [](const std::string& path, const StampedPath& other) { return path == other.path; });
}

// Compares a stage that is about to run with its stamp; may bring the stamp's input states up to date.
std::string Reason(const Workspace& workspace, const Stage& stage, StageStamp* stamp, Reporter& reporter) {
  std::string reason = VersionReason(*stamp);
  if (reason.empty()) reason = OptionsReason(stage.options, stamp->options);
  if (!reason.empty()) return reason;
  std::map<std::string, std::string> upstream;
  for (const std::string& name : stage.depends_on) upstream[name] = "";
  const bool has_same_upstream =
      std::equal(upstream.begin(), upstream.end(), stamp->upstream.begin(), stamp->upstream.end(),
                 [](const auto& a, const auto& b) { return a.first == b.first; });
  if (!has_same_upstream) return "it depends on other stages than before";
  reason = UpstreamReason(workspace, stamp->upstream, reporter);
  if (!reason.empty()) return reason;
  if (!AreSame(StampPaths(workspace, stage.inputs), stamp->inputs)) return "it reads other files than before";
  if (!AreSame(StampPaths(workspace, stage.outputs), stamp->outputs))
    return "it writes other files than before";
  reason = InputsReason(workspace, &stamp->inputs, reporter);
  return reason.empty() ? OutputsReason(workspace, stamp->outputs) : reason;
}

bool HaveSameStates(const std::vector<StampedPath>& a, const std::vector<StampedPath>& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](const StampedPath& x, const StampedPath& y) {
    return x.fingerprint.state == y.fingerprint.state;
  });
}

bool IsStageName(const std::string& name) {
  return !name.empty() && std::all_of(name.begin(), name.end(), [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_';
  });
}

bool HaveAll(const std::vector<fs::path>& paths) {
  std::error_code ec;
  return std::all_of(paths.begin(), paths.end(), [&](const fs::path& path) { return fs::exists(path, ec); });
}

}  // namespace

std::map<std::string, std::string> ValuesWithout(const Options& options,
                                                 const std::vector<std::string>& left_out) {
  std::map<std::string, std::string> values = options.Values();
  for (const std::string& name : left_out) values.erase(name);
  return values;
}

std::vector<StageStatus> CheckStages(const Workspace& workspace, Reporter& reporter) {
  std::vector<StandardStage> stages = StandardStages(workspace);
  std::vector<std::string> others;
  std::error_code ec;
  for (fs::directory_iterator entry(workspace.Stages(), ec), end; !ec && entry != end; entry.increment(ec)) {
    const std::string name = entry->path().stem().string();
    const auto is_it = [&](const StandardStage& stage) { return stage.name == name; };
    if (entry->path().extension() != ".json" || !IsStageName(name)) continue;
    if (std::none_of(stages.begin(), stages.end(), is_it)) others.push_back(name);
  }
  std::sort(others.begin(), others.end());
  for (const std::string& name : others) stages.push_back({name, {}, ""});

  std::map<std::string, StageStatus> by_name;
  for (const StandardStage& stage : stages) {
    StageStatus& status = by_name[stage.name];
    status.name = stage.name;
    status.stamp = ReadStageStamp(workspace, stage.name, reporter);
    if (!status.stamp.has_value()) {
      const bool has_outputs = !stage.outputs.empty() && HaveAll(stage.outputs);
      status.state = has_outputs ? StageState::kForeign : StageState::kMissing;
      continue;
    }
    StageStamp stamp = *status.stamp;
    status.reason = VersionReason(stamp);
    if (status.reason.empty()) status.reason = OutputsReason(workspace, stamp.outputs);
    if (status.reason.empty()) status.reason = InputsReason(workspace, &stamp.inputs, reporter);
    if (status.reason.empty()) status.reason = UpstreamReason(workspace, stamp.upstream, reporter);
    status.state = status.reason.empty() ? StageState::kDone : StageState::kStale;
  }
  // What follows a stale stage is stale: passed on until nothing changes, which ends even when stamps lie
  // about what depends on what.
  for (bool has_changed = true; has_changed;) {
    has_changed = false;
    for (auto& [name, status] : by_name) {
      if (status.state != StageState::kDone) continue;
      for (const auto& [upstream, run_id] : status.stamp->upstream) {
        const auto other = by_name.find(upstream);
        if (other == by_name.end() || other->second.state != StageState::kStale) continue;
        status.state = StageState::kStale;
        status.reason = upstream + " is stale";
        has_changed = true;
        break;
      }
    }
  }
  std::vector<StageStatus> result;
  result.reserve(stages.size());
  for (const StandardStage& stage : stages) result.push_back(std::move(by_name[stage.name]));
  return result;
}

StageRunner::StageRunner(Workspace workspace, Reporter& reporter)
    : workspace_(std::move(workspace)), reporter_(reporter), lock_(workspace_, reporter) {
  RemoveStaleWorkspaceTemporaries(workspace_);
}

void StageRunner::Refresh(const std::string& name, const StageStamp& stamp) {
  try {
    WriteStageStamp(workspace_, name, stamp);
  } catch (const UserError& error) {
    // Next time the inputs are read again, which takes longer and finds the same.
    reporter_.Debug(error.what());
  }
}

double StageRunner::SecondsOfStagesSince(double begin) const {
  double sum = 0;
  for (const auto& [name, ran] : ran_) {
    if (ran.first >= begin && ReadStageStamp(workspace_, name, reporter_).has_value()) sum += ran.second;
  }
  return sum;
}

bool StageRunner::Run(const Stage& stage, const std::function<void()>& work) {
  S2GS_INVARIANT(IsStageName(stage.name));
  std::string reason = kNotDoneYet;
  if (std::optional<StageStamp> stamp = ReadStageStamp(workspace_, stage.name, reporter_);
      stamp.has_value()) {
    const std::vector<StampedPath> known = stamp->inputs;
    reason = Reason(workspace_, stage, &*stamp, reporter_);
    if (reason.empty()) {
      if (!HaveSameStates(known, stamp->inputs)) Refresh(stage.name, *stamp);
      reporter_.Info(stage.name + ": up to date");
      return false;
    }
  }
  if (reporter_.StopRequested()) throw Interrupted();
  for (const auto& written : {stage.outputs, stage.also_writes}) {
    for (const fs::path& path : written) RequireNoLinkOut(workspace_.root, path);
  }
  reporter_.Info(stage.name + ": runs (" + reason + ")");

  StageStamp stamp;
  stamp.run_id = NewRunId();
  stamp.program_version = Version();
  stamp.reason = reason;
  stamp.options = stage.options;
  for (const fs::path& path : stage.inputs) {
    stamp.inputs.push_back({StampPath(workspace_, path), TakeFingerprint(path, reporter_)});
  }
  for (const std::string& name : stage.depends_on) {
    const std::optional<StageStamp> upstream = ReadStageStamp(workspace_, name, reporter_);
    stamp.upstream[name] = upstream.has_value() ? upstream->run_id : "";
  }
  RemoveStageStamp(workspace_, stage.name);
  const double begin = SteadySeconds();
  work();
  const double seconds = SteadySeconds() - begin;
  stamp.seconds = std::max(0.0, seconds - SecondsOfStagesSince(begin));
  ran_[stage.name] = {begin, seconds};

  for (const fs::path& path : stage.outputs) {
    const Fingerprint fingerprint = TakeState(path);
    if (!fingerprint.exists) {
      throw UserError(path, stage.name + " ended without writing it",
                      "See the messages above, or run again with --log_level debug");
    }
    SyncToDisk(path);
    stamp.outputs.push_back({StampPath(workspace_, path), fingerprint});
  }
  stamp.finished = UtcNow();
  WriteStageStamp(workspace_, stage.name, stamp);
  reporter_.Info(stage.name + ": done in " + FormatDuration(stamp.seconds));
  return true;
}

}  // namespace s2gs
