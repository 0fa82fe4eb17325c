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
      // That a stage had not run before explains nothing.
      return stage.stamp->reason.empty() || stage.stamp->reason == kNotDoneYet
                 ? ""
                 : "ran because: " + stage.stamp->reason;
    case StageState::kStale:
      return "should run again: " + stage.reason;
    case StageState::kForeign:
      return "its files are there, but this program did not make them";
    case StageState::kMissing:
      return "has not run";
  }
  return "";
}

ScanPlan PlanOf(const ReportInput& input) {
  PlanRequest request;
  request.workspace = input.workspace;
  request.forced = PlannedForced(input.workspace.Plan());
  Reporter silent;
  return MakeScanPlan(request, silent);
}

// What some scenes do not need: left out or not, and what that rests on.
void WritePlan(const ScanPlan& plan, const ScanSummary& summary, ReportSection* section) {
  HtmlWriter& out = section->html;
  const std::vector<std::string> head = {"part", "", "measured", "threshold", "why", "saves"};
  out.Element("h3", "What the scene does not need");
  nlohmann::ordered_json& left_out = section->numbers["left_out"] = nlohmann::ordered_json::array();
  for (const auto& [what, why] : summary.left_out) left_out.push_back({{"what", what}, {"why", why}});
  section->numbers["plan"] = nlohmann::ordered_json::array();
  std::string later;
  for (const PlanState state : {PlanState::kLeftOut, PlanState::kRuns, PlanState::kLater}) {
    // What was left out is news; what runs as usual is there for who asks.
    const auto count = std::count_if(plan.decisions.begin(), plan.decisions.end(),
                                     [&](const PlanDecision& decision) { return decision.state == state; });
    const bool has_table = state != PlanState::kLater && count > 0;
    const bool is_folded = has_table && state == PlanState::kRuns;
    if (is_folded)
      out.Open("details").Element("summary", Count(count, "part") + " that the scene needs, and why");
    if (has_table) {
      out.Open("div", {{"class", "scroll"}}).Open("table", {{"class", "wide plan"}});
      WriteRow(head, &out, "th");
    }
    for (const PlanDecision& decision : plan.decisions) {
      if (decision.state != state) continue;
      section->numbers["plan"].push_back({{"part", decision.part},
                                          {"state", PlanStateName(state)},
                                          {"measured", decision.measured},
                                          {"threshold", decision.threshold},
                                          {"reason", decision.reason},
                                          {"saving", decision.saving},
                                          {"forced", decision.is_forced}});
      if (state == PlanState::kLater) {
        later += (later.empty() ? "To be decided by what later stages measure: " : "; ") + WhatOf(decision);
        continue;
      }
      out.Open("tr").Element("td", WhatOf(decision));
      out.Open("td")
          .Element("span", std::string(PlanStateName(state)) + (decision.is_forced ? ", forced" : ""),
                   {{"class", state == PlanState::kLeftOut ? "state done" : "state"}})
          .Close();
      const std::vector<std::string> cells = {decision.measured, decision.threshold, decision.reason,
                                              decision.saving};
      for (size_t i = 0; i < cells.size(); ++i) {
        out.Element("td", cells[i], {{"data-head", cells[i].empty() ? "" : head[i + 2] + ": "}});
      }
      out.Close();
    }
    if (has_table) out.Close().Close();
    if (is_folded) out.Close();
  }
  if (!later.empty()) out.Element("p", later + ".", {{"class", "note"}});
}

}  // namespace

ReportSection StagesSection(const ReportInput& input, const ScanSummary& summary) {
  ReportSection section{"stages", "Stages and time", {}, {}};
  section.numbers = nlohmann::ordered_json::object();
  HtmlWriter& out = section.html;
  const ScanPlan plan = PlanOf(input);
  const PlanDecision& background = plan.Of("background");
  double longest = 0;
  for (const StageStatus& stage : input.stages) {
    if (stage.stamp) longest = std::max(longest, stage.stamp->seconds);
  }
  out.Open("div", {{"class", "scroll"}}).Open("table", {{"class", "wide times"}});
  const bool says_why = std::any_of(input.stages.begin(), input.stages.end(), [](const StageStatus& stage) {
    return stage.name != "report" && !Why(stage).empty();
  });
  WriteRow({"stage", "state", "time", "", says_why ? "why" : ""}, &out, "th");
  nlohmann::ordered_json& stages = section.numbers["list"] = nlohmann::ordered_json::array();
  for (const StageStatus& stage : input.stages) {
    if (stage.name == "report") continue;
    const bool is_left_out = stage.name == "background_mapper" && stage.state == StageState::kMissing &&
                             background.state == PlanState::kLeftOut;
    const std::string state = is_left_out ? PlanStateName(background.state) : StateName(stage.state);
    const std::string why = is_left_out ? background.reason : Why(stage);
    out.Open("tr").Element("td", stage.name);
    out.Open("td").Element("span", state, {{"class", fmt::format("state {}", state)}}).Close();
    out.Element("td", stage.stamp ? FormatDuration(stage.stamp->seconds) : "–");
    out.Open("td", {{"class", "barcell"}});
    if (stage.stamp && longest > 0) {
      const double percent = 100 * stage.stamp->seconds / longest;
      out.Element("span", "",
                  {{"class", "timebar"},
                   {"style", fmt::format("width:{}%", ShortNumber(std::max(0.5, percent), 1))}});
    }
    out.Close().Element("td", why).Close();
    nlohmann::ordered_json json = {{"name", stage.name}, {"state", state}, {"why", why}};
    if (stage.stamp) {
      json["seconds"] = stage.stamp->seconds;
      json["finished"] = stage.stamp->finished;
    }
    stages.push_back(json);
  }
  out.Close().Close();
  WritePlan(plan, summary, &section);
  return section;
}

}  // namespace s2gs
