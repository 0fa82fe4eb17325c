#pragma once

#include <cstdint>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <ostream>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "plugin/stage/workspace.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

/// What becomes of a part of a scan.
enum class PlanState : uint8_t {
  kRuns,
  kLeftOut,
  kLater,  ///< what decides it is measured by a stage that has not run.
};
const char* PlanStateName(PlanState state);  ///< "runs", "left out", "later".

/// One decision and what it rests on, in words for people, numbers with their units.
struct PlanDecision {
  std::string part;  ///< one of PlanParts().
  PlanState state = PlanState::kLater;
  std::string measured;   ///< empty where nothing was measured.
  std::string threshold;  ///< that it was compared with.
  std::string reason;
  std::string saving;  ///< expected, or measured where the stage has run.
  bool is_forced = false;
};

/// The part in words.
const std::string& WhatOf(const PlanDecision& decision);

/// A stage as it stands.
struct PlanStage {
  std::string name;
  std::string state;  ///< "runs", "done", "not asked for".
  std::string reason;
  double seconds = 0;  ///< that it took when it ran last; 0: it never did.
};

/// What a scan will do, leaves out and cannot know yet.
struct ScanPlan {
  size_t num_photos = 0;
  double megapixels = 0;  ///< of a photo, the median.
  std::vector<PlanStage> stages;
  std::vector<PlanDecision> decisions;  ///< in the order of PlanParts().

  const PlanDecision& Of(const std::string& part) const;
};

/// What is asked for.
struct PlanRequest {
  Workspace workspace;               ///< need not exist.
  std::filesystem::path image_path;  ///< the photos; empty: none known.
  bool has_masks = false;
  bool trains = true;
  bool meshes = true;
  bool textures = true;
  std::set<std::string> forced;  ///< parts.
};

/// Gathers the decisions from where they were taken: the photos, and what the stages left in the workspace.
/// It decides nothing that another part of the program decides too. What cannot be read counts as not there.
/// Throws UserError when the photos cannot be listed.
ScanPlan MakeScanPlan(const PlanRequest& request, Reporter& reporter);

/// {"version": 1, "photos": {"count", "megapixels"}, "stages": [{"name", "state", "reason", "seconds"}],
/// "decisions": [{"part", "what", "stage", "state", "measured", "threshold", "reason", "saving",
/// "decided_after", "forced", "can_be_forced", "never_forced"}]}: the last says why nothing can force it.
nlohmann::ordered_json PlanToJson(const ScanPlan& plan);

/// Reads what PlanToJson() made, its decisions alone; empty where there is none, or a damaged one.
std::vector<PlanDecision> ReadPlannedDecisions(const std::filesystem::path& path);
/// The parts that were asked for, which stands nowhere else than there.
std::set<std::string> PlannedForced(const std::filesystem::path& path);

/// Writes plan.json. Throws UserError.
void WriteScanPlan(const std::filesystem::path& path, const ScanPlan& plan);

/// The stages and all decisions.
void PrintScanPlan(const ScanPlan& plan, std::ostream& out);
/// Only the decisions that stand in another way than before.
void PrintNewDecisions(const ScanPlan& before, const ScanPlan& now, std::ostream& out);

}  // namespace s2gs
