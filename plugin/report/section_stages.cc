#include <fmt/format.h>

#include <algorithm>

#include "plugin/cli/console_reporter.h"
#include "plugin/plan/scan_plan.h"
#include "plugin/report/sections.h"

namespace s2gs {
namespace {

const char* StateName(StageState state) {
  switch (state) {
    case StageState::kDone:
      return "done";
    case StageState::kStale:
      return "stale";
    case StageState::kMissing:
      return "missing";
    case StageState::kForeign:
      return "from elsewhere";
  }
  return "";
}

std::string Why(const StageStatus& stage) {
  switch (stage.state) {
    case StageState::kDone:
      return stage.stamp->reason.empty() ? "" : "ran because: " + stage.stamp->reason;
    case StageState::kStale:
      return "should run again: " + stage.reason;
    case StageState::kForeign:
      return "its files are there, but this program did not make them";
    case StageState::kMissing:
      return "has not run";
  }
  return "";
}

// What some scenes do not need: left out or not, and what that rests on.
void WritePlan(const ReportInput& input, const ScanSummary& summary, ReportSection* section) {
  HtmlWriter& out = section->html;
  PlanRequest request;
  request.workspace = input.workspace;
  Reporter silent;
  const ScanPlan plan = MakeScanPlan(request, silent);
  const std::vector<PlanDecision> planned = ReadPlannedDecisions(input.workspace.Plan());
  out.Element("h3", "What the scene does not need");
  out.Open("div", {{"class", "scroll"}}).Open("table", {{"class", "wide plan"}});
  WriteRow({"part", "", "measured", "threshold", "why", "saves"}, &out, "th");
  nlohmann::ordered_json& left_out = section->numbers["left_out"] = nlohmann::ordered_json::array();
  for (const auto& [what, why] : summary.left_out) left_out.push_back({{"what", what}, {"why", why}});
  section->numbers["plan"] = nlohmann::ordered_json::array();
  for (const PlanState state : {PlanState::kLeftOut, PlanState::kRuns, PlanState::kLater}) {
    for (const PlanDecision& decision : plan.decisions) {
      if (decision.state != state) continue;
      const bool is_forced = std::any_of(planned.begin(), planned.end(), [&](const PlanDecision& other) {
        return other.part == decision.part && other.is_forced;
      });
      out.Open("tr").Element("td", WhatOf(decision));
      out.Open("td")
          .Element("span", std::string(PlanStateName(state)) + (is_forced ? ", forced" : ""),
                   {{"class", state == PlanState::kLeftOut ? "state done" : "state"}})
          .Close();
      for (const std::string& cell :
           {decision.measured, decision.threshold, decision.reason, decision.saving}) {
        out.Element("td", cell);
      }
      out.Close();
      section->numbers["plan"].push_back({{"part", decision.part},
                                          {"state", PlanStateName(state)},
                                          {"measured", decision.measured},
                                          {"threshold", decision.threshold},
                                          {"reason", decision.reason},
                                          {"saving", decision.saving},
                                          {"forced", is_forced}});
    }
  }
  out.Close().Close();
}

}  // namespace

ReportSection StagesSection(const ReportInput& input, const ScanSummary& summary) {
  ReportSection section{"stages", "Stages and time", {}, {}};
  section.numbers = nlohmann::ordered_json::object();
  HtmlWriter& out = section.html;
  double longest = 0;
  for (const StageStatus& stage : input.stages) {
    if (stage.stamp) longest = std::max(longest, stage.stamp->seconds);
  }
  out.Open("div", {{"class", "scroll"}}).Open("table", {{"class", "wide times"}});
  WriteRow({"stage", "state", "time", "", "why"}, &out, "th");
  nlohmann::ordered_json& stages = section.numbers["list"] = nlohmann::ordered_json::array();
  for (const StageStatus& stage : input.stages) {
    if (stage.name == "report") continue;
    out.Open("tr").Element("td", stage.name);
    out.Open("td")
        .Element("span", StateName(stage.state), {{"class", fmt::format("state {}", StateName(stage.state))}})
        .Close();
    out.Element("td", stage.stamp ? FormatDuration(stage.stamp->seconds) : "–");
    out.Open("td", {{"class", "barcell"}});
    if (stage.stamp && longest > 0) {
      const double percent = 100 * stage.stamp->seconds / longest;
      out.Element("span", "",
                  {{"class", "timebar"},
                   {"style", fmt::format("width:{}%", ShortNumber(std::max(0.5, percent), 1))}});
    }
    out.Close().Element("td", Why(stage)).Close();
    nlohmann::ordered_json json = {
        {"name", stage.name}, {"state", StateName(stage.state)}, {"why", Why(stage)}};
    if (stage.stamp) {
      json["seconds"] = stage.stamp->seconds;
      json["finished"] = stage.stamp->finished;
    }
    stages.push_back(json);
  }
  out.Close().Close();
  WritePlan(input, summary, &section);
  return section;
}

}  // namespace s2gs
