#include "plugin/commands/automatic_scanner_command.h"

#include <fmt/format.h>
#include <sys/resource.h>

#include <algorithm>
#include <filesystem>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "plugin/cli/shell_quote.h"
#include "plugin/photos/photo_import.h"
#include "plugin/plan/plan_parts.h"
#include "plugin/plan/scan_plan.h"
#include "plugin/report/scan_summary.h"
#include "plugin/scan/scan_preflight.h"
#include "plugin/scan/scan_steps.h"
#include "plugin/shared_options/backend_choice.h"
#include "plugin/shared_options/quality.h"
#include "plugin/shared_options/scale_options.h"
#include "plugin/stage/stage_stamp.h"
#include "plugin/stage/workspace.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/stopwatch.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

const Command& FindCommand(const std::string& name) {
  const std::vector<Command>& commands = AllCommands();
  const auto found = std::find_if(commands.begin(), commands.end(),
                                  [&](const Command& command) { return command.name == name; });
  S2GS_INVARIANT(found != commands.end());
  return *found;
}

std::string ShellLine(const ScanStep& step) {
  return "s2gs " + step.command + " " + ShellQuoted(step.arguments);
}

double CpuSeconds() {
  double seconds = 0;
  for (const int who : {RUSAGE_SELF, RUSAGE_CHILDREN}) {
    rusage usage = {};
    ::getrusage(who, &usage);
    for (const timeval& time : {usage.ru_utime, usage.ru_stime}) {
      seconds += static_cast<double>(time.tv_sec) + 1e-6 * static_cast<double>(time.tv_usec);
    }
  }
  return seconds;
}

// By name.
std::map<std::string, StageStamp> ReadStamps(const Workspace& workspace, const std::string& command) {
  std::map<std::string, StageStamp> stamps;
  Reporter silent;  // the command itself says what is wrong with a stamp
  for (const StandardStage& stage : StandardStages(workspace)) {
    if (stage.command != command) continue;
    const std::optional<StageStamp> stamp = ReadStageStamp(workspace, stage.name, silent);
    if (stamp) stamps[stage.name] = *stamp;
  }
  return stamps;
}

// Which stages of a command ran, by their stamps before and after it. Returns whether any did.
bool AddStages(const Workspace& workspace, const std::string& command,
               const std::map<std::string, StageStamp>& before, ScanSummary* summary) {
  const std::map<std::string, StageStamp> after = ReadStamps(workspace, command);
  bool has_any_run = false;
  for (const StandardStage& stage : StandardStages(workspace)) {
    const auto now = after.find(stage.name);
    if (now == after.end()) continue;
    const StageStamp& stamp = now->second;
    const auto then = before.find(stage.name);
    const bool has_run = then == before.end() || then->second.run_id != stamp.run_id;
    const std::string reason =
        has_run ? stamp.reason : "done " + stamp.finished + ", and nothing that it depends on has changed";
    summary->stages.push_back({stage.name, has_run, reason, stamp.seconds});
    has_any_run = has_any_run || has_run;
  }
  return has_any_run;
}

ScanSummary::Step RunStep(const ScanStep& step, size_t number, size_t count, std::ostream& out) {
  out << fmt::format("\n[{}/{}] {}: s2gs {}\n", number, count, step.title, step.command) << std::flush;
  const double started = SteadySeconds();
  const double cpu_started = CpuSeconds();
  CommandContext context(step.command, step.arguments, out);
  FindCommand(step.command).run(context);
  ScanSummary::Step result;
  result.command = step.command;
  result.title = step.title;
  result.shell_line = ShellLine(step);
  result.wall_seconds = SteadySeconds() - started;
  result.cpu_seconds = CpuSeconds() - cpu_started;
  return result;
}

// Whether the photos can be used where they are.
void FindPhotos(const Workspace& workspace, ScanSettings* settings) {
  if (settings->given_path.empty()) settings->given_path = workspace.Images();
  settings->image_path = settings->given_path;
  std::error_code ec;
  settings->is_video = fs::is_regular_file(settings->given_path, ec);
  if (!settings->is_video) {
    if (!fs::is_directory(settings->given_path, ec)) {
      throw UserError(
          settings->given_path, "there is no such folder of photos",
          "Give the photos' folder as --image_path, or put them into " + workspace.Images().string());
    }
    ImportPlan plan = PlanImport(settings->given_path);
    if (!plan.is_needed) return;
    settings->import = std::move(plan);
  }
  settings->image_path = workspace.Imported();
  // Photos with alpha are their own masks.
  if (settings->mask_path == settings->given_path) settings->mask_path = settings->image_path;
}

// What training, masks and the mesh are told.
void AddModelOptions(Options& options, ScanSettings* settings) {
  options.Add("test_every", &settings->test_every,
              "hold every n-th photo out of training and of the texture, and measure both on it; 0: none");
  options.Add("num_iterations", &settings->num_iterations, "steps of training; empty: as --quality says");
  options
      .Add("max_image_size", &settings->max_image_size,
           "longer side of the photos in training; empty: as --quality says")
      .Unit("px");
  options.Add(
      "camera_params", &settings->camera_params,
      "the photos' lens where it is known: f,cx,cy,k of COLMAP's SIMPLE_RADIAL in pixels, which poses "
      "refine by a few percent; empty: by EXIF, or a guess");
  options.Add(
      "first_octave", &settings->first_octave,
      "0: features are looked for at the photos' own size, not at twice that: poses take half of the CPU "
      "seconds, errors are up to twice as large, and plain objects may find no place; empty: COLMAP's, -1");
  options.AddEnum("plain_table", &settings->plain_table, {{"object", "object"}, {"background", "background"}},
                  "whose, in masks, a plain table with a round top is: photos do not tell whether it turns");
  options.Add("keep_disc", &settings->keep_disc, "leave the table's disc in the mesh");
}

// Every option of the scan, with what -h says of it.
Options& DeclareOptions(CommandContext& context, ScanSettings* settings) {
  Options& options = context.Declare(
      "Photos of an object on a turntable to everything: camera poses and the table's motion, a Gaussian "
      "model, object masks and a textured mesh. Runs the other commands one after another; what is done is "
      "skipped, and a run that was stopped goes on where it was. Photos that COLMAP cannot read, and the "
      "frames of "
      "a video, are imported into the workspace first. Options, photos, masks, disk, memory and "
      "colmap are checked first, and all that is wrong is listed at once. The plan is printed before "
      "anything long runs: what runs, what is left out and why; decisions that need a stage's measurements "
      "follow it. Each step's own command line is printed: run it by hand to change more of it. Ends with "
      "report.html, which judges the scan and shows all of it.",
      "--workspace_path scan --image_path photos --quality medium");
  options.Add("workspace_path", &settings->workspace_path, "the workspace; created when it does not exist")
      .Required();
  options.Add(
      "image_path", &settings->given_path,
      "the photos, in whatever format and in folders, or a video file; empty: images in the workspace");
  options.Add("video_frames", &settings->video_frames,
              "frames taken of a video: the sharpest of so many intervals");
  options.Add("ffmpeg_path", &settings->ffmpeg_path,
              "the ffmpeg executable or its folder, for videos; empty: searched for on PATH");
  options.Add("mask_path", &settings->mask_path,
              "masks of the rotating part, if there are any: a.jpg.png for a.jpg (COLMAP), a.jpg.mask.png "
              "(RealityScan), a.png (LichtFeld, or the cut-out photo with alpha); empty: none");
  options.AddEnum("quality", &settings->quality, kQualityNames,
                  "how much time to spend; auto: high on a GPU, low without one");
  options.AddEnum("until", &settings->until,
                  {{"split", ScanUntil::kSplit}, {"train", ScanUntil::kTrain}, {"mesh", ScanUntil::kMesh}},
                  "the last part to run: poses and sparse models, the Gaussian model, or all");
  options.Add("use_gpu", &settings->use_gpu, "auto, 0 or 1");
  AddModelOptions(options, settings);
  options.Add("angles_path", &settings->angles_path,
              "table angles that are known: a CSV file of NAME,ANGLE in degrees, or the folder of OpenScan's "
              "scan or project; used where the photos bear them out; empty: none");
  options.Add("step_deg", &settings->step_deg, "the table's step from photo to photo by name; 0: unknown")
      .Unit("degrees");
  options.Add("texture", &settings->texture,
              "give the mesh the colours of the photos: dense/0/textured-tsdf.glb, .obj and .ply");
  options.Add("force", &settings->force,
              "1: go on to training when the poses are doubtful or have failed; without it the scan stops "
              "there, with exit code 3. Names of parts or stages, separated by commas: run what the plan "
              "leaves out (scan_planner lists the parts)");
  options.Add("colmap_path", &settings->colmap_path,
              "the colmap executable or its folder; empty: searched for on PATH");
  options.Section("Scale",
                  "lengths that are known, for a scene in metres: markers, a board, points, the disc",
                  [&] { AddScaleOptions(&options, &settings->scale); });
  return options;
}

// The steps one after another, what each of them says about the rest, and the report at the end.
class Scan {
 public:
  Scan(const ScanSettings& settings, const Workspace& workspace, std::ostream& out, Reporter& reporter)
      : settings_(settings),
        workspace_(workspace),
        out_(out),
        reporter_(reporter),
        steps_(ScanSteps(settings)) {}

  const std::vector<ScanStep>& steps() const { return steps_; }

  void Run() {
    size_t next = 0;
    if (settings_.Imports()) summary_.steps.push_back(RunStep(steps_[next++], 1, NumSteps(), out_));
    plan_ = MakeScanPlan(PlanOf(settings_), reporter_);
    PrintScanPlan(plan_, out_);
    WriteScanPlan(workspace_.Plan(), plan_);
    for (; next < steps_.size(); ++next) {
      if (reporter_.StopRequested()) throw Interrupted();
      RunOne(next);
      const bool has_poses = steps_[next].command == "turntable_mapper";
      if (has_poses && settings_.until != ScanUntil::kSplit) StopWhereDoubtful();
    }
    Finish();
  }

 private:
  // With the report, which is a step of its own.
  size_t NumSteps() const { return steps_.size() + 1; }

  void RunOne(size_t i) {
    const std::string& command = steps_[i].command;
    const std::map<std::string, StageStamp> before = ReadStamps(workspace_, command);
    ScanSummary::Step step;
    try {
      step = RunStep(steps_[i], i + 1, NumSteps(), out_);
    } catch (const UserError&) {
      // Where no photo found a place, the report shows why; without that the message says all there is.
      if (command == "turntable_mapper" && ReadPoseVerdict(workspace_).verdict == "failed") Finish();
      throw;
    }
    step.has_run = AddStages(workspace_, command, before, &summary_);
    summary_.steps.push_back(step);
    PlanAgain();
  }

  // What a step has measured decides more.
  void PlanAgain() {
    const ScanPlan now = MakeScanPlan(PlanOf(settings_), reporter_);
    PrintNewDecisions(plan_, now, out_);
    WriteScanPlan(workspace_.Plan(), now);
    plan_ = now;
  }

  void StopWhereDoubtful() {
    if (settings_.forced.count("doubtful_poses") > 0) return;
    const ScanSummary::PoseVerdict poses = ReadPoseVerdict(workspace_);
    if (poses.verdict.empty() || poses.poses_hold) return;
    Finish();
    throw DoubtfulResult("the poses " +
                         std::string(poses.verdict == "failed" ? "have failed" : "are doubtful") +
                         ", so that training on them was not begun. They are kept in " +
                         workspace_.root.string() + "; --force 1 goes on with them.");
  }

  void Finish() {
    WriteScanRecord(workspace_.ScanRecord(), summary_);
    summary_.steps.push_back(RunStep(ReportStep(settings_), NumSteps(), NumSteps(), out_));
    CollectFigures(workspace_, &summary_);
    PrintScanSummary(summary_, out_);
  }

  const ScanSettings& settings_;
  const Workspace& workspace_;
  std::ostream& out_;
  Reporter& reporter_;
  std::vector<ScanStep> steps_;
  ScanPlan plan_;
  ScanSummary summary_;
};

}  // namespace

void RunAutomaticScanner(CommandContext& context) {
  ScanSettings settings;
  const Options& options = DeclareOptions(context, &settings);
  Reporter& reporter = context.Parse();
  settings.forced = ForcedParts(settings.force);
  settings.random_seed = options.random_seed();
  settings.log_level = options.log_level();
  settings.has_gpu = settings.use_gpu != "0" && GpuProblem({}).empty();
  RequireComplete(settings.scale);

  const Workspace workspace{settings.workspace_path};
  FindPhotos(workspace, &settings);
  Scan scan(settings, workspace, context.out(), reporter);
  RequireSoundScan(RequestOf(settings, scan.steps()), reporter);
  CreateFolder(workspace.Own());
  // Each command locks the workspace for itself; another scan may not come between them.
  const WorkspaceLock lock(workspace, workspace.ScanLockFile(), reporter);
  scan.Run();
}

}  // namespace s2gs
