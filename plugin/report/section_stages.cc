#include <fmt/format.h>

#include <algorithm>

#include "plugin/cli/console_reporter.h"
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
  out.Element("h3", "Left out");
  nlohmann::ordered_json& left_out = section.numbers["left_out"] = nlohmann::ordered_json::array();
  if (summary.left_out.empty()) {
    out.Element("p", "Nothing: this scan needed every part.");
  } else {
    out.Open("ul");
    for (const auto& [what, why] : summary.left_out) {
      out.Open("li").Element("b", what).Text(": " + why).Close();
      left_out.push_back({{"what", what}, {"why", why}});
    }
    out.Close();
  }
  return section;
}

}  // namespace s2gs
