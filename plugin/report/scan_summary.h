#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <ostream>
#include <string>
#include <utility>
#include <vector>

#include "plugin/stage/workspace.h"

namespace s2gs {

/// What a whole scan did and what came out of it.
struct ScanSummary {
  struct Step {
    std::string command;
    std::string title;
    std::string shell_line;  ///< runs this step alone.
    double wall_seconds = 0;
    double cpu_seconds = 0;  ///< of all threads and of `colmap`.
    bool has_run = true;     ///< false: all its stages were done before.
  };
  std::vector<Step> steps;
  /// A stage of one of the steps' commands.
  struct Stage {
    std::string name;
    bool has_run = false;  ///< else it was done before.
    std::string reason;    ///< why it ran, or since when it is done.
    double seconds = 0;    ///< that it took, now or then.
  };
  std::vector<Stage> stages;
  /// What the poses are worth: "good", "doubtful" or "failed", why, and what to photograph differently. Empty
  /// before they are there.
  struct PoseVerdict {
    std::string verdict;
    std::vector<std::string> reasons;
    std::vector<std::string> advice;
    bool poses_hold = true;  ///< at most a few photos are missing, and nothing is wrong with the others.
  };
  PoseVerdict verdict;
  std::vector<std::pair<std::string, std::string>> left_out;  ///< by the plan: what, and the measured reason.
  std::vector<std::pair<std::string, std::string>> figures;   ///< name and value with its unit.
  std::vector<std::pair<std::string, std::filesystem::path>> files;  ///< what, where; those that exist.
};

/// What turntable_mapper says of its poses; empty where it has not run, or where what it wrote cannot be
/// read.
ScanSummary::PoseVerdict ReadPoseVerdict(const Workspace& workspace);

/// Fills in the verdict, what was left out, the figures and the files from what the steps left in the
/// workspace. What cannot be read is missing from the summary.
void CollectFigures(const Workspace& workspace, ScanSummary* summary);

/// {"steps": [...], "stages": [...], "verdict": {"verdict", "reasons": [...], "advice": [...]} or null,
/// "left_out": [...], "figures": {...}, "files": {...}}, as in report.json.
nlohmann::ordered_json SummaryToJson(const ScanSummary& summary);

/// s2gs/scan.json: steps and stages of the scanner's last run, from which a report can be made again. A step
/// none of whose stages had to run keeps the times that the record has for the same line, so that a run which
/// did nothing leaves the record as it was. Throws UserError.
void WriteScanRecord(const std::filesystem::path& path, const ScanSummary& summary);

/// Empty when there is none, or a damaged one.
ScanSummary ReadScanRecord(const std::filesystem::path& path);

void PrintScanSummary(const ScanSummary& summary, std::ostream& out);

}  // namespace s2gs
