#include "plugin/curves/work_curve.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <string>
#include <system_error>
#include <tuple>
#include <utility>

#include "sfm_split/base/error.h"
#include "sfm_split/base/infinity.h"
#include "sfm_split/base/parse_number.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

// Whether every run came to a result.
bool IsReached(const WorkSetting& setting) { return setting.runs > 0 && setting.reached == setting.runs; }

bool Dominates(const WorkSetting& a, const WorkSetting& b) {
  const double time = a.seconds.median - b.seconds.median;
  const double error = a.error.median - b.error.median;
  return time <= 0 && error <= 0 && (time < 0 || error < 0);
}

double LeastError(const std::vector<WorkSetting>& settings, int scene) {
  double least = kInfinity;
  for (const WorkSetting& setting : settings) {
    if (setting.scene == scene && IsReached(setting)) least = std::min(least, setting.error.median);
  }
  return least;
}

// Numbers in the order in which `values` has its first two, whatever comes between them; others stay.
void SortFromCheapToCostly(std::vector<std::string>* values) {
  std::map<std::string, double> number_of;
  for (const std::string& value : *values) {
    if (ParseNumber(value, &number_of[value]) != std::errc()) return;
  }
  if (values->size() < 2) return;
  const bool rises = number_of[(*values)[0]] < number_of[(*values)[1]];
  std::stable_sort(values->begin(), values->end(), [&](const std::string& a, const std::string& b) {
    return rises ? number_of[a] < number_of[b] : number_of[a] > number_of[b];
  });
}

}  // namespace

Spread SpreadOf(const std::vector<double>& values) {
  if (values.empty()) return {kInfinity, kInfinity, kInfinity};
  const Summary summary = Summarize(values);
  return {summary.min, summary.median, summary.max};
}

std::optional<double> WorkPoint::Figure(const std::string& name) const {
  const auto found = figures.find(name);
  if (!failure.empty() || found == figures.end() || !std::isfinite(found->second)) return std::nullopt;
  return found->second;
}

std::vector<WorkSetting> SumUp(const WorkCurve& curve) {
  std::vector<WorkSetting> settings;
  for (int scene = 0; scene < static_cast<int>(curve.scenes.size()); ++scene) {
    for (const std::string& value : curve.values) {
      WorkSetting setting;
      setting.scene = scene;
      setting.value = value;
      std::vector<double> cpu, wall, errors;
      for (const WorkPoint& point : curve.points) {
        if (point.scene != scene || point.value != value) continue;
        ++setting.runs;
        cpu.push_back(point.cpu_seconds);
        wall.push_back(point.wall_seconds);
        if (const std::optional<double> error = point.Figure(curve.error)) errors.push_back(*error);
      }
      if (setting.runs == 0) continue;
      setting.reached = static_cast<int>(errors.size());
      setting.cpu_seconds = SpreadOf(cpu);
      setting.wall_seconds = SpreadOf(wall);
      setting.seconds = curve.time == CurveTime::kWall ? setting.wall_seconds : setting.cpu_seconds;
      setting.error = SpreadOf(errors);
      settings.push_back(setting);
    }
  }
  for (WorkSetting& setting : settings) {
    setting.is_pareto =
        IsReached(setting) && std::none_of(settings.begin(), settings.end(), [&](const WorkSetting& other) {
          return other.scene == setting.scene && IsReached(other) && Dominates(other, setting);
        });
  }
  return settings;
}

std::optional<double> TimeToShare(const std::vector<WorkSetting>& settings, int scene, double share) {
  const double target = LeastError(settings, scene) / share;
  if (!std::isfinite(target)) return std::nullopt;
  std::optional<double> time;
  for (const WorkSetting& setting : settings) {
    if (setting.scene != scene || !IsReached(setting) || setting.error.median > target) continue;
    time = std::min(time.value_or(kInfinity), setting.seconds.median);
  }
  return time;
}

double ProfileAt(const std::vector<WorkSetting>& settings, int num_scenes, const std::string& value,
                 double ratio, double tolerance) {
  int within = 0;
  for (int scene = 0; scene < num_scenes; ++scene) {
    const double bound = (1 + tolerance) * LeastError(settings, scene);
    double fastest = kInfinity;
    double own = kInfinity;
    for (const WorkSetting& setting : settings) {
      if (setting.scene != scene || !IsReached(setting) || !(setting.error.median <= bound)) continue;
      fastest = std::min(fastest, setting.seconds.median);
      if (setting.value == value) own = setting.seconds.median;
    }
    within += std::isfinite(own) && own <= ratio * fastest ? 1 : 0;
  }
  return num_scenes == 0 ? 0 : static_cast<double>(within) / num_scenes;
}

WorkCurve MergeCurves(const std::vector<WorkCurve>& curves) {
  S2GS_INVARIANT(!curves.empty());
  WorkCurve all = curves[0];
  std::set<std::tuple<int, std::string, uint64_t>> runs;
  all.points.clear();
  // The place of a text in a list, at whose end it is put where it is not there yet.
  const auto place = [](const std::string& text, std::vector<std::string>* list) {
    const auto found = std::find(list->begin(), list->end(), text);
    const auto index = static_cast<int>(found - list->begin());
    if (found == list->end()) list->push_back(text);
    return index;
  };
  for (const WorkCurve& curve : curves) {
    if (curve.knob != all.knob || curve.error != all.error || curve.reference != all.reference ||
        curve.time != all.time) {
      throw UserError("--curves: " + all.knob + " (" + all.error_text + ", against " + all.reference +
                      ") and " + curve.knob + " (" + curve.error_text + ", against " + curve.reference +
                      ") are not the same measurement. Give curves of one knob and one error");
    }
    for (const std::string& value : curve.values) place(value, &all.values);
    for (WorkPoint point : curve.points) {
      point.scene = place(curve.scenes.at(static_cast<size_t>(point.scene)), &all.scenes);
      const std::string& scene = all.scenes[static_cast<size_t>(point.scene)];
      if (!runs.emplace(point.scene, point.value, point.seed).second) {
        throw UserError("--curves: the run of " + scene + ", " + point.value + ", seed " +
                        std::to_string(point.seed) + " is there twice. Give each curve once");
      }
      all.points.push_back(std::move(point));
    }
  }
  SortFromCheapToCostly(&all.values);
  return all;
}

}  // namespace s2gs
