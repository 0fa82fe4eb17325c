#include "plugin/report/scan_verdict.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "plugin/report/table_steps.h"

namespace s2gs {
namespace {

using Json = nlohmann::json;
using Grade = ScanVerdict::Grade;

constexpr double kMaxMissing = 0.1;     // of the photos
constexpr double kMaxAngleSigma = 0.1;  // of a step of the table

std::vector<std::string> Strings(const Json& object, const char* key) {
  std::vector<std::string> strings;
  const auto found = object.find(key);
  if (found == object.end() || !found->is_array()) return strings;
  for (const Json& entry : *found) {
    if (entry.is_string()) strings.push_back(entry.get<std::string>());
  }
  return strings;
}

// The smallest step of any station; 0 when none turned.
double SmallestStep(const ReportInput& input) {
  double smallest = 0;
  if (!input.turntable) return smallest;
  for (const StationSteps& station : FindSteps(*input.turntable)) {
    if (station.deviations_deg.empty()) continue;
    const double step = std::abs(station.step_deg);
    smallest = smallest == 0 ? step : std::min(smallest, step);
  }
  return smallest;
}

ScanVerdict JudgeByFigures(const ReportInput& input) {
  ScanVerdict verdict;
  const Json& mapper = input.mapper;
  const double photos = NumberOr(mapper, "images");
  const double placed = NumberOr(mapper, "registered");
  if (!(placed > 0)) {
    verdict.grade = Grade::kFailed;
    verdict.reasons = {"no photo has a pose"};
    verdict.advice = {
        "Photograph with more overlap, and put something with texture, a newspaper say, on the table"};
    return verdict;
  }
  const auto doubt = [&](const std::string& reason, const std::string& advice) {
    verdict.reasons.push_back(reason);
    verdict.advice.push_back(advice);
  };
  if (photos - placed > kMaxMissing * photos) {
    doubt(fmt::format("{} of {} photos have no pose", photos - placed, photos),
          "Take the photos around the missing ones again in smaller steps of the table");
  }
  const Json observability = mapper.value("observability", Json::object());
  const double nullity = NumberOr(observability, "nullity");
  if (nullity > 0) {
    doubt(fmt::format("{} of what is sought is not determined by the photos",
                      Count(static_cast<size_t>(nullity), "direction")),
          "Take a second station at another height, and let the table turn all the way round at each");
  }
  if (!mapper.value("stable", true)) {
    doubt("the adjustment still changed in its last round", "Give it more rounds with --Refine.max_rounds");
  }
  const Json sigma = mapper.value("sigma", Json::object());
  const double worst = NumberOr(sigma, "angle_max_deg");
  const double step = SmallestStep(input);
  if (step > 0 && !(worst < kMaxAngleSigma * step)) {
    doubt(std::isnan(worst) ? std::string("a table angle cannot be determined")
                            : fmt::format("a table angle is known to ±{}° only, with steps of {}°",
                                          Significant(worst, 2), Significant(step, 3)),
          "Put something with texture on the table around the object");
  }
  verdict.grade = verdict.reasons.empty() ? Grade::kGood : Grade::kDoubtful;
  return verdict;
}

}  // namespace

const char* GradeName(Grade grade) {
  switch (grade) {
    case Grade::kUnknown:
      return "unknown";
    case Grade::kGood:
      return "good";
    case Grade::kDoubtful:
      return "doubtful";
    case Grade::kFailed:
      return "failed";
  }
  return "";
}

ScanVerdict JudgeScan(const ReportInput& input) {
  if (!input.mapper.is_object()) return {};
  const auto given = input.mapper.find("verdict");
  if (given == input.mapper.end()) return JudgeByFigures(input);
  // Either the grade beside its reasons, or all in one object.
  const Json& holder = given->is_object() ? *given : input.mapper;
  const auto name = holder.find("verdict");
  ScanVerdict verdict;
  for (const Grade grade : {Grade::kGood, Grade::kDoubtful, Grade::kFailed}) {
    if (name != holder.end() && *name == GradeName(grade)) verdict.grade = grade;
  }
  verdict.reasons = Strings(holder, "reasons");
  verdict.advice = Strings(holder, "advice");
  return verdict;
}

}  // namespace s2gs
