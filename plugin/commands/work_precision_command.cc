#include "plugin/commands/work_precision_command.h"

#include <fmt/format.h>

#include <cstdint>
#include <filesystem>
#include <ostream>
#include <string>
#include <vector>

#include "plugin/curves/forced_parts.h"
#include "plugin/curves/sweep.h"
#include "plugin/curves/work_curve_files.h"
#include "plugin/curves/work_curve_page.h"
#include "plugin/plan/plan_parts.h"
#include "plugin/stage/workspace.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

// What --time says.
enum class Clock : uint8_t { kAuto, kCpu, kWall };
const EnumNames<Clock> kClockNames = {{"auto", Clock::kAuto}, {"cpu", Clock::kCpu}, {"wall", Clock::kWall}};

struct Paths {
  std::vector<std::string> workspaces, images, truths, curves;
  fs::path output;
};

std::string KnobList() {
  std::string list;
  for (const Knob& knob : AllKnobs()) list += (list.empty() ? "" : ", ") + knob.name;
  return list;
}

// One for each workspace, or none.
std::vector<std::string> Matched(const std::vector<std::string>& given, size_t count, const char* name) {
  if (given.empty()) return std::vector<std::string>(count);
  if (given.size() != count) {
    throw CommandLineError(
        fmt::format("--{} has {} folders, --workspace_path has {}: give one for each, or none.", name,
                    given.size(), count));
  }
  return given;
}

void PrintCurve(const WorkCurve& curve, std::ostream& out) {
  const std::vector<WorkSetting> settings = SumUp(curve);
  out << fmt::format("{}; error: {}, against {}\n", curve.what, curve.error_text, curve.reference);
  for (size_t scene = 0; scene < curve.scenes.size(); ++scene) {
    out << fmt::format("\n{}\n{:>12} {:>12} {:>12} {:>12} {:>10}  Pareto\n", curve.scenes[scene], "value",
                       "CPU [s]", "wall [s]", "error", "reached");
    for (const WorkSetting& setting : settings) {
      if (setting.scene != static_cast<int>(scene)) continue;
      out << fmt::format("{:>12} {:>12.4g} {:>12.4g} {:>12} {:>10}  {}\n", setting.value,
                         setting.cpu_seconds.median, setting.wall_seconds.median,
                         setting.reached > 0 ? fmt::format("{:.4g}", setting.error.median) : "-",
                         fmt::format("{} of {}", setting.reached, setting.runs),
                         setting.is_pareto ? "yes" : "");
    }
  }
}

// The parts named; none: all that are left out.
std::vector<std::string> PartsOf(const std::string& forced) {
  std::vector<std::string> names;
  std::string name;
  for (const char c : forced + ",") {
    if (c != ',') {
      name += c;
      continue;
    }
    if (!name.empty() && name != "1") names.push_back(name);
    name.clear();
  }
  ForcedParts(names);  // says which there are
  return names;
}

// What the plans leave out, forced: measured, or read where files are given.
void RunForced(const SweepOptions& sweep, const std::vector<std::string>& parts,
               const std::vector<std::string>& files, fs::path output, std::ostream& out,
               Reporter& reporter) {
  if (output.empty()) output = sweep.scenes[0].workspace / "work_precision" / "forced";
  ForcedRuns runs;
  if (files.empty()) {
    runs = MeasureForcedParts(sweep, parts, reporter);
  } else {
    std::vector<ForcedRuns> read;
    read.reserve(files.size());
    for (const std::string& path : files) read.push_back(ReadForced(path));
    runs = MergeForcedRuns(read);
  }
  const std::vector<ForcedPart> measured = runs.Parts();
  if (output.has_parent_path()) CreateFolder(output.parent_path());
  WriteFileAtomically(output.string() + ".csv", [&](std::ostream& file) { WriteForcedCsv(measured, file); });
  WriteFileAtomically(output.string() + ".json", [&](std::ostream& file) { WriteForcedJson(runs, file); });
  PrintForcedParts(measured, out);
  out << "\n" << output.string() << ".csv and .json\n";
}

// What the command line asks for.
struct Request {
  Paths paths;
  std::string forced;
  SweepOptions sweep;
  std::string knob;
  Clock clock = Clock::kAuto;

  bool IsForced() const { return !forced.empty() && forced != "0"; }
};

void AddRequest(Options* options, Request* request) {
  options->Add("workspace_path", &request->paths.workspaces, "the scans; several give performance profiles");
  options->Add(
      "knob", &request->knob,
      "one of " + KnobList() + ", or any option of a stage's command as COMMAND.OPTION; empty: --forced");
  options->Add("values", &request->sweep.values, "of the knob, from cheap to costly; empty: the knob's own");
  options->Add(
      "forced", &request->forced,
      "1, or names of parts with commas: what each part that the plan leaves out (scan_planner) would have "
      "cost and gained; --arguments are then COMMAND.NAME=VALUE");
  options->Add(
      "curves", &request->paths.curves,
      "instead of a knob: JSON files that this command wrote, of one knob and other scenes, seeds or "
      "values, as one; with --forced 1 files of forced parts; nothing is run");
  options->AddEnum("time", &request->clock, kClockNames,
                   "which time counts for the Pareto set: wall means something where runs had a GPU to "
                   "themselves; auto: wall with --use_gpu 1 --jobs 1, else cpu");
  options->Add("seeds", &request->sweep.seeds, "random seeds; stages before the knob's stay as they are");
  options->Add("image_path", &request->paths.images,
               "the photos, one folder for each scan; empty: images in the workspaces");
  options->Add(
      "ground_truth_path", &request->paths.truths,
      "data sets as scan_evaluator takes them, one for each scan; empty: poses and meshes are measured "
      "against the run of the last value");
  options->Add("arguments", &request->sweep.arguments,
               "more options for the knob's command as NAME=VALUE, {workspace} is the scan's folder; e.g. "
               "quality=low,test_list={workspace}/test_list.txt (training needs photos held out)");
  options->Add("use_gpu", &request->sweep.use_gpu, "auto, 0 or 1");
  options->Add("jobs", &request->sweep.jobs, "runs at a time; wall times mean something with 1 alone");
  options->Add("keep_files", &request->sweep.keep_files,
               "keep all files of every run, not those alone that comparisons need");
  options->Add("output_path", &request->paths.output,
               "beginning of the names PATH.csv, PATH.json and PATH.html; empty: work_precision/KNOB in the "
               "first scan");
}

void RefuseWhatDoesNotGoTogether(const Request& request) {
  if (request.sweep.jobs < 1) throw CommandLineError("--jobs is below 1.");
  const bool has_files = !request.paths.curves.empty();
  if (request.knob.empty() ? !request.IsForced() && !has_files : request.IsForced() || has_files) {
    throw CommandLineError("give one of --knob, --forced and --curves, or --curves with --forced 1.");
  }
  if (has_files && request.IsForced() && request.forced != "1") {
    throw CommandLineError("--curves takes all parts that its files have: give --forced 1.");
  }
  if (request.paths.curves.empty() == request.paths.workspaces.empty()) {
    throw CommandLineError(request.paths.curves.empty() ? "--workspace_path is missing."
                                                        : "--curves needs no --workspace_path.");
  }
}

}  // namespace

void RunWorkPrecision(CommandContext& context) {
  Request request;
  Options& options = context.Declare(
      "Error against run time of one stage of finished scans: runs it again with every value of one knob and "
      "every "
      "seed, each in a workspace of its own that takes the stages before from the scan. Runs that are done "
      "are not "
      "made again. Writes CSV, JSON and an HTML page of diagrams, and names the settings that nothing beats "
      "in both.",
      "--workspace_path scan --knob joint_tolerance --seeds 0,1,2 --ground_truth_path data/falcon_desk");
  AddRequest(&options, &request);
  Reporter& reporter = context.Parse();
  RefuseWhatDoesNotGoTogether(request);
  Paths& paths = request.paths;
  SweepOptions& sweep = request.sweep;
  const bool by_wall = request.clock == Clock::kWall ||
                       (request.clock == Clock::kAuto && sweep.use_gpu == "1" && sweep.jobs == 1);
  if (!request.knob.empty()) sweep.knob = FindKnob(request.knob);
  const size_t count = paths.workspaces.size();
  paths.images = Matched(paths.images, count, "image_path");
  paths.truths = Matched(paths.truths, count, "ground_truth_path");
  for (size_t i = 0; i < count; ++i) {
    sweep.scenes.push_back({paths.workspaces[i], paths.images[i], paths.truths[i]});
  }
  if (paths.output.empty() && paths.workspaces.empty()) throw CommandLineError("--output_path is missing.");
  if (request.IsForced()) {
    return RunForced(sweep, PartsOf(request.forced), paths.curves, paths.output, context.out(), reporter);
  }
  if (paths.output.empty()) paths.output = sweep.scenes[0].workspace / "work_precision" / sweep.knob.name;

  WorkCurve curve;
  if (paths.curves.empty()) {
    curve = RunSweep(sweep, reporter);
    curve.time = by_wall ? CurveTime::kWall : CurveTime::kCpu;
  } else {
    std::vector<WorkCurve> read;
    for (const std::string& path : paths.curves) {
      read.push_back(ReadCurve(path));
      if (request.clock != Clock::kAuto) read.back().time = by_wall ? CurveTime::kWall : CurveTime::kCpu;
    }
    curve = MergeCurves(read);
  }
  if (paths.output.has_parent_path()) CreateFolder(paths.output.parent_path());
  const auto write = [&](const char* extension, void (*writer)(const WorkCurve&, std::ostream&)) {
    WriteFileAtomically(paths.output.string() + extension, [&](std::ostream& out) { writer(curve, out); });
  };
  write(".csv", WriteCurveCsv);
  write(".json", WriteCurveJson);
  write(".html", WriteCurvePage);
  PrintCurve(curve, context.out());
  context.out() << "\n" << paths.output.string() << ".html, .csv and .json\n";
}

}  // namespace s2gs
