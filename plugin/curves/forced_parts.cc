#include "plugin/curves/forced_parts.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <sstream>
#include <utility>

#include "plugin/cli/version.h"
#include "plugin/curves/work_curve_files.h"
#include "plugin/plan/plan_parts.h"
#include "plugin/plan/scan_plan.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

constexpr char kPlanned[] = "planned";
constexpr uint64_t kMaxForcedBytes = uint64_t{1} << 28;
constexpr size_t kSeedsOfSpread = 3;  // the least that tell how far seeds spread

// The part of a scan that parts of one command belong to, as a knob without values.
struct Group {
  Knob knob;
  std::vector<const PlanPart*> parts;
};

Knob GroupKnob(KnobStage stage) {
  switch (stage) {
    case KnobStage::kPoses:
      return {"forced_poses",
              "parts left out of the poses",
              stage,
              "motion_splitter",
              "",
              "motion_splitter",
              {"motion_splitter", "turntable_mapper"},
              {},
              {}};
    case KnobStage::kTraining:
      return {"forced_training",
              "parts left out of training",
              stage,
              "gaussian_trainer",
              "",
              "gaussian_trainer",
              {"gaussian_trainer"},
              {},
              {}};
    case KnobStage::kMesh:
      return {"forced_mesh",
              "parts left out of the mesh",
              stage,
              "gaussian_renderer",
              "",
              "image_undistorter",
              {"gaussian_renderer", "tsdf_mesher"},
              {},
              {}};
  }
  return {};
}

KnobStage StageOf(const PlanPart& part) {
  if (part.command == "gaussian_trainer") return KnobStage::kTraining;
  return part.command == "gaussian_renderer" || part.command == "tsdf_mesher" ? KnobStage::kMesh
                                                                              : KnobStage::kPoses;
}

bool IsWanted(const PlanPart& part, const ScanPlan& plan, const std::vector<std::string>& asked) {
  if (part.forced_by.empty()) return false;
  if (!asked.empty()) return std::find(asked.begin(), asked.end(), part.name) != asked.end();
  return plan.Of(part.name).state == PlanState::kLeftOut;
}

// Those of COMMAND.NAME=VALUE that are for the command.
std::vector<std::string> ArgumentsOf(const std::string& command, const std::vector<std::string>& all) {
  std::vector<std::string> own;
  const std::string prefix = command + ".";
  for (const std::string& argument : all) {
    if (argument.compare(0, prefix.size(), prefix) == 0) own.push_back(argument.substr(prefix.size()));
  }
  return own;
}

nlohmann::ordered_json Finite(double value) {
  if (!std::isfinite(value)) return nullptr;
  return value;
}

// The median over the runs as planned; NaN where none tells it.
double PlannedSigma(const WorkCurve& curve, int scene) {
  std::vector<double> sigmas;
  for (const WorkPoint& point : curve.points) {
    if (point.scene != scene || point.value != kPlanned) continue;
    if (const std::optional<double> sigma = point.Figure("axis_sigma_deg")) sigmas.push_back(*sigma);
  }
  return sigmas.empty() ? std::numeric_limits<double>::quiet_NaN() : Summarize(sigmas).median;
}

nlohmann::ordered_json ToJson(const Spread& spread) {
  return {{"min", Finite(spread.min)}, {"median", Finite(spread.median)}, {"max", Finite(spread.max)}};
}

// The runs of one seed, as planned and with a part.
struct RunPair {
  const WorkPoint* planned = nullptr;
  const WorkPoint* forced = nullptr;
};

// Of the seeds that have an error in both.
std::vector<RunPair> PairsOf(const WorkCurve& curve, int scene, const std::string& part) {
  std::map<uint64_t, RunPair> by_seed;
  for (const WorkPoint& point : curve.points) {
    if (point.scene != scene || !point.Figure(curve.error)) continue;
    if (point.value == kPlanned) by_seed[point.seed].planned = &point;
    if (point.value == part) by_seed[point.seed].forced = &point;
  }
  std::vector<RunPair> pairs;
  for (const auto& [seed, pair] : by_seed) {
    if (pair.planned != nullptr && pair.forced != nullptr) pairs.push_back(pair);
  }
  return pairs;
}

std::string WhatOf(const std::string& name) {
  for (const PlanPart& part : PlanParts()) {
    if (part.name == name) return part.what;
  }
  return name;
}

ForcedPart PartOf(const WorkCurve& curve, int scene, const std::string& part) {
  ForcedPart row;
  row.scene = curve.scenes.at(static_cast<size_t>(scene));
  row.part = part;
  row.what = WhatOf(part);
  row.error_text = curve.error_text;
  std::vector<double> planned, forced, planned_seconds, forced_seconds, gains;
  for (const RunPair& pair : PairsOf(curve, scene, part)) {
    planned.push_back(*pair.planned->Figure(curve.error));
    forced.push_back(*pair.forced->Figure(curve.error));
    planned_seconds.push_back(pair.planned->cpu_seconds);
    forced_seconds.push_back(pair.forced->cpu_seconds);
    gains.push_back(planned.back() - forced.back());
  }
  row.seeds = static_cast<int>(gains.size());
  row.planned_error = SpreadOf(planned);
  row.forced_error = SpreadOf(forced);
  row.planned_cpu_seconds = SpreadOf(planned_seconds);
  row.forced_cpu_seconds = SpreadOf(forced_seconds);
  const bool is_of_poses = curve.knob == GroupKnob(KnobStage::kPoses).name;
  if (is_of_poses) {
    if (curve.error == ErrorOf(KnobStage::kPoses, true).figure) row.gain_sigma = PlannedSigma(curve, scene);
  } else if (gains.size() >= kSeedsOfSpread) {
    const Summary summary = Summarize(gains);
    double squares = 0;
    for (const double gain : gains) squares += (gain - summary.mean) * (gain - summary.mean);
    const auto num = static_cast<double>(gains.size());
    row.mean_gain = summary.mean;
    row.gain_sigma = std::sqrt(squares / (num * (num - 1)));
  }
  for (const WorkPoint& point : curve.points) {
    const bool is_it = point.scene == scene && (point.value == part || point.value == kPlanned);
    if (is_it && !point.failure.empty()) row.failure = point.failure;
  }
  if (row.seeds == 0 && row.failure.empty()) row.failure = "no seed was run both as planned and with it";
  return row;
}

}  // namespace

double ForcedPart::GainSigmas() const {
  return mean_gain.value_or(planned_error.median - forced_error.median) / gain_sigma;
}

double ForcedPart::GainPct() const {
  const double gain = 100 * (planned_error.median - forced_error.median) / planned_error.median;
  return std::isfinite(gain) ? gain : std::numeric_limits<double>::quiet_NaN();
}

std::vector<ForcedPart> ForcedRuns::Parts() const {
  std::vector<std::string> scenes;
  for (const WorkCurve& curve : curves) {
    for (const std::string& scene : curve.scenes) {
      if (std::find(scenes.begin(), scenes.end(), scene) == scenes.end()) scenes.push_back(scene);
    }
  }
  std::vector<ForcedPart> parts;
  for (const std::string& name : scenes) {
    for (const WorkCurve& curve : curves) {
      const auto found = std::find(curve.scenes.begin(), curve.scenes.end(), name);
      if (found == curve.scenes.end()) continue;
      const auto scene = static_cast<int>(found - curve.scenes.begin());
      for (const std::string& value : curve.values) {
        const bool has_runs =
            std::any_of(curve.points.begin(), curve.points.end(),
                        [&](const WorkPoint& point) { return point.scene == scene && point.value == value; });
        if (value != kPlanned && has_runs) parts.push_back(PartOf(curve, scene, value));
      }
    }
  }
  return parts;
}

ForcedRuns MeasureForcedParts(const SweepOptions& options, const std::vector<std::string>& parts,
                              Reporter& reporter) {
  ForcedRuns runs;
  for (const SweptScene& scene : options.scenes) {
    PlanRequest request;
    request.workspace = Workspace{scene.workspace};
    const ScanPlan plan = MakeScanPlan(request, reporter);
    for (const KnobStage stage : {KnobStage::kPoses, KnobStage::kTraining, KnobStage::kMesh}) {
      SweepOptions sweep = options;
      sweep.scenes = {scene};
      sweep.knob = GroupKnob(stage);
      sweep.knob.settings = {{kPlanned, "", {}}};
      sweep.values = {kPlanned};
      for (const PlanPart& part : PlanParts()) {
        if (StageOf(part) != stage || !IsWanted(part, plan, parts)) continue;
        sweep.knob.settings.push_back({part.name, part.command, part.forced_by});
        sweep.values.push_back(part.name);
      }
      if (sweep.values.size() < 2) continue;
      sweep.arguments = ArgumentsOf(sweep.knob.command, options.arguments);
      runs.curves.push_back(RunSweep(sweep, reporter));
    }
  }
  return runs;
}

ForcedRuns MergeForcedRuns(const std::vector<ForcedRuns>& all) {
  std::vector<std::vector<WorkCurve>> alike;  // of one stage and one error
  for (const ForcedRuns& runs : all) {
    for (const WorkCurve& curve : runs.curves) {
      const auto found = std::find_if(alike.begin(), alike.end(), [&](const std::vector<WorkCurve>& group) {
        return group[0].knob == curve.knob && group[0].error == curve.error &&
               group[0].reference == curve.reference;
      });
      if (found == alike.end()) {
        alike.push_back({curve});
      } else {
        found->push_back(curve);
      }
    }
  }
  ForcedRuns merged;
  for (const std::vector<WorkCurve>& group : alike) merged.curves.push_back(MergeCurves(group));
  return merged;
}

void WriteForcedCsv(const std::vector<ForcedPart>& parts, std::ostream& out) {
  out << "scene,part,error_of,planned_error,forced_error,gain_pct,gain_sigmas,planned_cpu_s,forced_cpu_s,"
         "failure\n";
  const auto quoted = [](const std::string& text) {
    std::string result = "\"";
    for (const char c : text) result += c == '"' ? std::string("\"\"") : std::string(1, c);
    return result + "\"";
  };
  for (const ForcedPart& part : parts) {
    out << fmt::format("{},{},{},{:.6g},{:.6g},{:.4g},{:.4g},{:.4g},{:.4g},{}\n", quoted(part.scene),
                       part.part, quoted(part.error_text), part.planned_error.median,
                       part.forced_error.median, part.GainPct(), part.GainSigmas(),
                       part.planned_cpu_seconds.median, part.forced_cpu_seconds.median, quoted(part.failure));
  }
}

void WriteForcedJson(const ForcedRuns& runs, std::ostream& out) {
  nlohmann::ordered_json json = {{"version", 1},
                                 {"program", Version()},
                                 {"parts", nlohmann::ordered_json::array()},
                                 {"curves", nlohmann::ordered_json::array()}};
  for (const ForcedPart& part : runs.Parts()) {
    json["parts"].push_back({{"scene", part.scene},
                             {"part", part.part},
                             {"what", part.what},
                             {"error_of", part.error_text},
                             {"seeds", part.seeds},
                             {"planned_error", ToJson(part.planned_error)},
                             {"forced_error", ToJson(part.forced_error)},
                             {"gain_pct", Finite(part.GainPct())},
                             {"mean_gain", Finite(part.mean_gain.value_or(std::nan("")))},
                             {"gain_sigma", Finite(part.gain_sigma)},
                             {"gain_sigmas", Finite(part.GainSigmas())},
                             {"planned_cpu_s", ToJson(part.planned_cpu_seconds)},
                             {"forced_cpu_s", ToJson(part.forced_cpu_seconds)},
                             {"failure", part.failure}});
  }
  for (const WorkCurve& curve : runs.curves) {
    std::ostringstream text;
    WriteCurveJson(curve, text);
    json["curves"].push_back(nlohmann::ordered_json::parse(text.str()));
  }
  out << json.dump(1, ' ', false, nlohmann::ordered_json::error_handler_t::replace) << '\n';
}

ForcedRuns ReadForced(const std::filesystem::path& path) {
  const auto json = nlohmann::ordered_json::parse(ReadWholeFile(path, kMaxForcedBytes), nullptr, false);
  if (!json.is_object() || !json.contains("curves") || !json["curves"].is_array()) {
    throw UserError(path, "has no runs of forced parts", "Give the JSON that work_precision --forced wrote");
  }
  ForcedRuns runs;
  for (const auto& curve : json["curves"]) runs.curves.push_back(CurveOfJson(curve.dump(), path));
  return runs;
}

void PrintForcedParts(const std::vector<ForcedPart>& parts, std::ostream& out) {
  out << fmt::format("{:<16} {:<20} {:>12} {:>12} {:>9} {:>10} {:>10}\n", "scene", "part", "error",
                     "if forced", "gain", "CPU [s]", "if forced");
  for (const ForcedPart& part : parts) {
    if (part.seeds > 0) {
      out << fmt::format("{:<16} {:<20} {:>12.4g} {:>12.4g} {:>7.2f} % {:>10.3g} {:>10.3g}  {}\n", part.scene,
                         part.part, part.planned_error.median, part.forced_error.median, part.GainPct(),
                         part.planned_cpu_seconds.median, part.forced_cpu_seconds.median, part.error_text);
    }
    if (std::isfinite(part.GainSigmas())) {
      out << fmt::format("{:<37} {:.2g} standard deviations of {}\n", "", std::abs(part.GainSigmas()),
                         part.mean_gain ? "the mean over seeds" : "the tilt that all photos share");
    }
    if (!part.failure.empty()) out << fmt::format("{:<16} {:<20} {}\n", part.scene, part.part, part.failure);
  }
}

}  // namespace s2gs
