#include "plugin/curves/forced_parts.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <utility>

#include "plugin/cli/version.h"
#include "plugin/plan/plan_parts.h"
#include "plugin/plan/scan_plan.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

constexpr char kPlanned[] = "planned";
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
double PlannedSigma(const WorkCurve& curve) {
  std::vector<double> sigmas;
  for (const WorkPoint& point : curve.points) {
    if (point.value != kPlanned) continue;
    if (const std::optional<double> sigma = point.Figure("axis_sigma_deg")) sigmas.push_back(*sigma);
  }
  return sigmas.empty() ? std::numeric_limits<double>::quiet_NaN() : Summarize(sigmas).median;
}

nlohmann::ordered_json ToJson(const Spread& spread) {
  return {{"min", Finite(spread.min)}, {"median", Finite(spread.median)}, {"max", Finite(spread.max)}};
}

// By how much a part lowers the error, per seed that both have.
std::vector<double> GainsOfSeeds(const WorkCurve& curve, const std::string& part) {
  std::map<uint64_t, double> planned;
  for (const WorkPoint& point : curve.points) {
    if (point.value != kPlanned) continue;
    if (const std::optional<double> error = point.Figure(curve.error)) planned[point.seed] = *error;
  }
  std::vector<double> gains;
  for (const WorkPoint& point : curve.points) {
    if (point.value != part || planned.count(point.seed) == 0) continue;
    if (const std::optional<double> error = point.Figure(curve.error)) {
      gains.push_back(planned.at(point.seed) - *error);
    }
  }
  return gains;
}

}  // namespace

double ForcedPart::GainSigmas() const {
  return mean_gain.value_or(planned_error.median - forced_error.median) / gain_sigma;
}

double ForcedPart::GainPct() const {
  const double gain = 100 * (planned_error.median - forced_error.median) / planned_error.median;
  return std::isfinite(gain) ? gain : std::numeric_limits<double>::quiet_NaN();
}

std::vector<ForcedPart> MeasureForcedParts(const SweepOptions& options, const std::vector<std::string>& parts,
                                           Reporter& reporter) {
  std::vector<ForcedPart> measured;
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
      std::map<std::string, const PlanPart*> by_name;
      for (const PlanPart& part : PlanParts()) {
        if (StageOf(part) != stage || !IsWanted(part, plan, parts)) continue;
        sweep.knob.settings.push_back({part.name, part.command, part.forced_by});
        sweep.values.push_back(part.name);
        by_name[part.name] = &part;
      }
      if (by_name.empty()) continue;
      sweep.arguments = ArgumentsOf(sweep.knob.command, options.arguments);
      const WorkCurve curve = RunSweep(sweep, reporter);
      const std::vector<WorkSetting> settings = SumUp(curve);
      const auto planned = std::find_if(settings.begin(), settings.end(),
                                        [](const WorkSetting& s) { return s.value == kPlanned; });
      for (const WorkSetting& setting : settings) {
        if (setting.value == kPlanned) continue;
        ForcedPart row;
        row.scene = curve.scenes[0];
        row.part = setting.value;
        row.what = by_name.at(setting.value)->what;
        row.error_text = curve.error_text;
        row.planned_error = planned->error;
        row.planned_cpu_seconds = planned->cpu_seconds;
        row.forced_error = setting.error;
        row.forced_cpu_seconds = setting.cpu_seconds;
        if (curve.error == ErrorOf(KnobStage::kPoses, true).figure) row.gain_sigma = PlannedSigma(curve);
        const std::vector<double> gains = GainsOfSeeds(curve, setting.value);
        if (stage != KnobStage::kPoses && gains.size() >= kSeedsOfSpread) {
          const Summary summary = Summarize(gains);
          double squares = 0;
          for (const double gain : gains) squares += (gain - summary.mean) * (gain - summary.mean);
          const auto num = static_cast<double>(gains.size());
          row.mean_gain = summary.mean;
          row.gain_sigma = std::sqrt(squares / (num * (num - 1)));
        }
        for (const WorkPoint& point : curve.points) {
          const bool is_it = point.value == setting.value || point.value == kPlanned;
          if (is_it && !point.failure.empty()) row.failure = point.failure;
        }
        measured.push_back(std::move(row));
      }
    }
  }
  return measured;
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

void WriteForcedJson(const std::vector<ForcedPart>& parts, std::ostream& out) {
  nlohmann::ordered_json json = {
      {"version", 1}, {"program", Version()}, {"parts", nlohmann::ordered_json::array()}};
  for (const ForcedPart& part : parts) {
    json["parts"].push_back({{"scene", part.scene},
                             {"part", part.part},
                             {"what", part.what},
                             {"error_of", part.error_text},
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
  out << json.dump(1, ' ', false, nlohmann::ordered_json::error_handler_t::replace) << '\n';
}

void PrintForcedParts(const std::vector<ForcedPart>& parts, std::ostream& out) {
  out << fmt::format("{:<16} {:<20} {:>12} {:>12} {:>9} {:>10} {:>10}\n", "scene", "part", "error",
                     "if forced", "gain", "CPU [s]", "if forced");
  for (const ForcedPart& part : parts) {
    if (!part.failure.empty()) {
      out << fmt::format("{:<16} {:<20} {}\n", part.scene, part.part, part.failure);
      continue;
    }
    out << fmt::format("{:<16} {:<20} {:>12.4g} {:>12.4g} {:>7.2f} % {:>10.3g} {:>10.3g}  {}\n", part.scene,
                       part.part, part.planned_error.median, part.forced_error.median, part.GainPct(),
                       part.planned_cpu_seconds.median, part.forced_cpu_seconds.median, part.error_text);
    if (std::isfinite(part.GainSigmas())) {
      out << fmt::format("{:<37} {:.2g} standard deviations of {}\n", "", std::abs(part.GainSigmas()),
                         part.mean_gain ? "the mean over seeds" : "the tilt that all photos share");
    }
  }
}

}  // namespace s2gs
