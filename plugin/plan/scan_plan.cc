#include "plugin/plan/scan_plan.h"

#include <fmt/format.h>

#include <algorithm>

#include "plugin/cli/console_reporter.h"
#include "plugin/plan/plan_parts.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"

namespace s2gs {
namespace {

constexpr uint64_t kMaxPlanBytes = uint64_t{1} << 24;

const PlanPart& PartOf(const PlanDecision& decision) {
  const std::vector<PlanPart>& parts = PlanParts();
  const auto found = std::find_if(parts.begin(), parts.end(),
                                  [&](const PlanPart& part) { return part.name == decision.part; });
  S2GS_INVARIANT(found != parts.end());
  return *found;
}

void PrintDecision(const PlanDecision& decision, std::ostream& out) {
  const PlanPart& part = PartOf(decision);
  const std::string state =
      std::string(PlanStateName(decision.state)) + (decision.is_forced ? ", forced" : "");
  out << fmt::format("  {:<18}  {:<18}  {}\n", decision.part, state, part.what);
  const auto line = [&](const char* what, const std::string& text) {
    if (!text.empty()) out << fmt::format("  {:<18}  {:<18}  {}{}\n", "", "", what, text);
  };
  line("", decision.reason);
  std::string measured = decision.measured;
  if (!measured.empty() && !decision.threshold.empty()) measured += "; threshold: " + decision.threshold;
  line("measured: ", measured);
  line(decision.state == PlanState::kLeftOut ? "saves: " : "", decision.saving);
  if (decision.state == PlanState::kLeftOut) line("cannot be forced: ", part.never_forced);
}

bool AreSame(const PlanDecision& a, const PlanDecision& b) {
  return a.state == b.state && a.measured == b.measured && a.reason == b.reason;
}

}  // namespace

const char* PlanStateName(PlanState state) {
  switch (state) {
    case PlanState::kRuns:
      return "runs";
    case PlanState::kLeftOut:
      return "left out";
    case PlanState::kLater:
      return "later";
  }
  return "";
}

const std::string& WhatOf(const PlanDecision& decision) { return PartOf(decision).what; }

const PlanDecision& ScanPlan::Of(const std::string& part) const {
  const auto found = std::find_if(decisions.begin(), decisions.end(),
                                  [&](const PlanDecision& decision) { return decision.part == part; });
  S2GS_INVARIANT(found != decisions.end());
  return *found;
}

nlohmann::ordered_json PlanToJson(const ScanPlan& plan) {
  nlohmann::ordered_json json = {{"version", 1},
                                 {"photos", {{"count", plan.num_photos}, {"megapixels", plan.megapixels}}}};
  json["stages"] = nlohmann::ordered_json::array();
  for (const PlanStage& stage : plan.stages) {
    json["stages"].push_back(
        {{"name", stage.name}, {"state", stage.state}, {"reason", stage.reason}, {"seconds", stage.seconds}});
  }
  json["decisions"] = nlohmann::ordered_json::array();
  for (const PlanDecision& decision : plan.decisions) {
    const PlanPart& part = PartOf(decision);
    json["decisions"].push_back({{"part", decision.part},
                                 {"what", part.what},
                                 {"stage", part.stage},
                                 {"state", PlanStateName(decision.state)},
                                 {"measured", decision.measured},
                                 {"threshold", decision.threshold},
                                 {"reason", decision.reason},
                                 {"saving", decision.saving},
                                 {"decided_after", part.after.empty() ? "photos" : part.after},
                                 {"forced", decision.is_forced},
                                 {"can_be_forced", part.CanBeForced()},
                                 {"never_forced", part.never_forced}});
  }
  return json;
}

std::vector<PlanDecision> ReadPlannedDecisions(const std::filesystem::path& path) {
  std::error_code ec;
  if (!std::filesystem::is_regular_file(path, ec)) return {};
  std::vector<PlanDecision> decisions;
  try {
    const auto json = nlohmann::json::parse(ReadWholeFile(path, kMaxPlanBytes));
    for (const nlohmann::json& entry : json.at("decisions")) {
      PlanDecision decision;
      decision.part = entry.at("part").get<std::string>();
      const std::vector<PlanPart>& parts = PlanParts();
      if (std::none_of(parts.begin(), parts.end(),
                       [&](const PlanPart& part) { return part.name == decision.part; })) {
        continue;  // of another version
      }
      const auto state = entry.at("state").get<std::string>();
      decision.state = state == "runs"       ? PlanState::kRuns
                       : state == "left out" ? PlanState::kLeftOut
                                             : PlanState::kLater;
      decision.measured = entry.at("measured").get<std::string>();
      decision.threshold = entry.at("threshold").get<std::string>();
      decision.reason = entry.at("reason").get<std::string>();
      decision.saving = entry.at("saving").get<std::string>();
      decision.is_forced = entry.at("forced").get<bool>();
      decisions.push_back(std::move(decision));
    }
  } catch (const UserError&) {
    return {};
  } catch (const nlohmann::json::exception&) {
    return {};
  }
  return decisions;
}

std::set<std::string> PlannedForced(const std::filesystem::path& path) {
  std::set<std::string> forced;
  for (const PlanDecision& decision : ReadPlannedDecisions(path)) {
    if (decision.is_forced) forced.insert(decision.part);
  }
  return forced;
}

void WriteScanPlan(const std::filesystem::path& path, const ScanPlan& plan) {
  const std::string text =
      PlanToJson(plan).dump(1, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
  WriteFileAtomically(path, [&](std::ostream& out) { out << text; });
}

void PrintScanPlan(const ScanPlan& plan, std::ostream& out) {
  if (plan.num_photos > 0) {
    out << fmt::format("{} photos of {:.3g} megapixels\n", plan.num_photos, plan.megapixels);
  }
  out << "\nStages\n";
  for (const PlanStage& stage : plan.stages) {
    const std::string time = stage.seconds > 0 ? "took " + FormatDuration(stage.seconds) : "";
    out << fmt::format("  {:<18}  {:<14}  {:<12}  {}\n", stage.name, stage.state, time, stage.reason);
  }
  for (const PlanState state : {PlanState::kLeftOut, PlanState::kRuns, PlanState::kLater}) {
    std::string title = state == PlanState::kLeftOut ? "\nLeft out\n"
                        : state == PlanState::kRuns  ? "\nNot left out\n"
                                                     : "\nTo be decided\n";
    for (const PlanDecision& decision : plan.decisions) {
      if (decision.state != state) continue;
      out << std::exchange(title, "");
      PrintDecision(decision, out);
    }
  }
  out << std::flush;
}

void PrintNewDecisions(const ScanPlan& before, const ScanPlan& now, std::ostream& out) {
  std::string title = "\nDecided\n";
  for (const PlanDecision& decision : now.decisions) {
    if (decision.state == PlanState::kLater || AreSame(before.Of(decision.part), decision)) continue;
    out << std::exchange(title, "");
    PrintDecision(decision, out);
  }
  out << std::flush;
}

}  // namespace s2gs
