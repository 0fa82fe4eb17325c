#include "plugin/curves/sweep.h"

#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <cctype>
#include <map>
#include <mutex>
#include <optional>
#include <ostream>
#include <set>
#include <system_error>
#include <utility>

#include "plugin/cli/command.h"
#include "plugin/cli/version.h"
#include "plugin/colmap/child_process.h"
#include "plugin/curves/point_errors.h"
#include "plugin/curves/point_workspace.h"
#include "plugin/curves/work_curve_files.h"
#include "plugin/stage/stage_stamp.h"
#include "plugin/stage/workspace.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/stopwatch.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

// As a folder's name.
std::string FileName(const std::string& text) {
  std::string name;
  for (const char c : text) {
    name += std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '.' || c == '-' ? c : '_';
  }
  return name;
}

// {workspace} in an argument is the scan's folder, so that one argument fits several scans.
std::string InWorkspace(std::string text, const Workspace& workspace) {
  const std::string place = "{workspace}";
  const std::string root = fs::absolute(workspace.root).string();
  for (size_t at = text.find(place); at != std::string::npos; at = text.find(place, at + root.size())) {
    text.replace(at, place.size(), root);
  }
  return text;
}

struct Run {
  int scene = 0;
  std::string value;
  uint64_t seed = 0;
};

class Sweep {
 public:
  Sweep(const SweepOptions& options, Reporter& reporter) : o_(options), reporter_(reporter) {
    if (o_.values.empty()) o_.values = o_.knob.values;
    if (o_.program.empty()) {
      std::error_code ec;
      o_.program = fs::read_symlink("/proc/self/exe", ec);
    }
  }

  WorkCurve Make() {
    CheckOptions();
    for (const SweptScene& scene : o_.scenes) has_truth_ = has_truth_ && !scene.ground_truth.empty();
    needs_ruler_ = !has_truth_ && o_.knob.stage != KnobStage::kTraining && o_.knob.settings.empty();
    PrepareSeeds();
    std::vector<Run> runs;
    for (int scene = 0; scene < static_cast<int>(o_.scenes.size()); ++scene) {
      for (const std::string& value : o_.values) {
        for (const uint64_t seed : o_.seeds) runs.push_back({scene, value, seed});
      }
    }
    std::vector<WorkPoint> points(runs.size());
    std::atomic<int64_t> done{0};
    ParallelFor(static_cast<int64_t>(runs.size()), o_.jobs, [&](int64_t i) {
      points[static_cast<size_t>(i)] = MakePoint(runs[static_cast<size_t>(i)]);
      const std::lock_guard<std::mutex> lock(mutex_);
      reporter_.Progress("runs of the sweep", ++done, static_cast<int64_t>(runs.size()));
    });
    if (needs_ruler_) MeasureByRuler(&points);
    return CurveOf(std::move(points));
  }

 private:
  void CheckOptions() const {
    if (o_.values.size() < 2) throw UserError("a sweep needs at least two values. Give them as --values");
    if (std::set<std::string>(o_.values.begin(), o_.values.end()).size() != o_.values.size()) {
      throw UserError("--values has one value twice. Give each once");
    }
    for (const std::string& argument : o_.arguments) {
      if (argument.find('=') == std::string::npos) {
        throw UserError("--arguments: " + argument + " is no NAME=VALUE. Write for example quality=low");
      }
    }
    if (o_.seeds.empty()) throw UserError("a sweep needs at least one seed. Give them as --seeds");
    for (const SweptScene& scene : o_.scenes) {
      const Workspace base{scene.workspace};
      if (!Exists(base.root)) throw UserError(base.root, "no such folder", "Check --workspace_path");
      if (o_.knob.command != "tsdf_mesher" && scene.image_path.empty() && !Exists(base.Images())) {
        throw UserError(base.Images(), "there are no photos", "Give their folder as --image_path");
      }
    }
  }

  std::string SceneName(int scene) const {
    const fs::path path = fs::absolute(o_.scenes[static_cast<size_t>(scene)].workspace).lexically_normal();
    return path.has_filename() ? path.filename().string() : path.parent_path().filename().string();
  }

  Workspace Base(int scene) const { return {o_.scenes[static_cast<size_t>(scene)].workspace}; }
  fs::path Folder(int scene) const { return Base(scene).root / "work_precision" / FileName(o_.knob.name); }
  Workspace PointWorkspace(const Run& run) const {
    return {Folder(run.scene) / (FileName(run.value) + "_seed" + std::to_string(run.seed))};
  }

  // Seeds of the adjustment mean other runs of `colmap mapper`, which are no part of what the knob costs:
  // they are made once, and every value starts from them.
  bool HasSeedBases() const { return o_.knob.from == "turntable_mapper"; }
  Workspace SeedBase(int scene, uint64_t seed) const {
    if (!HasSeedBases()) return Base(scene);
    return {Folder(scene) / ("start_seed" + std::to_string(seed))};
  }

  void PrepareSeeds() {
    if (!HasSeedBases()) return;
    for (int scene = 0; scene < static_cast<int>(o_.scenes.size()); ++scene) {
      for (const uint64_t seed : o_.seeds) {
        const Workspace base = SeedBase(scene, seed);
        if (Exists(base.Turntable())) continue;
        reporter_.Info(SceneName(scene) + ": sparse models of seed " + std::to_string(seed));
        MakePointWorkspace(Base(scene), "object_mapper", base);
        const ChildExit end = RunCommand(o_.knob.command, scene, base, seed, {}, nullptr);
        if (!end.Succeeded())
          throw UserError(base.root / "run.log", "the start of the sweep failed", "It says why");
      }
    }
  }

  // What a run depends on: with another text it is made again.
  std::string SettingsText(const Run& run) const {
    std::string text = o_.knob.command + " " + o_.knob.option + " " + run.value + " seed " +
                       std::to_string(run.seed) + " s2gs " + Version() + " gpu " + o_.use_gpu;
    for (const std::string& argument : o_.arguments) text += " " + argument;
    for (const auto& [name, value] : o_.knob.fixed) text += fmt::format(" {}={}", name, value);
    for (const KnobSetting& setting : o_.knob.settings) {
      if (setting.value != run.value) continue;
      for (const auto& [name, value] : setting.options) text += fmt::format(" {}={}", name, value);
    }
    Reporter silent;
    for (const StandardStage& stage : StandardStages(Base(run.scene))) {
      if (stage.name == o_.knob.from) break;
      const std::optional<StageStamp> stamp = ReadStageStamp(Base(run.scene), stage.name, silent);
      text += " " + stage.name + "=" + (stamp ? stamp->run_id : "");
    }
    return text + " " + o_.scenes[static_cast<size_t>(run.scene)].ground_truth.string();
  }

  fs::path ImagePath(int scene, const Workspace& point) const {
    const fs::path& given = o_.scenes[static_cast<size_t>(scene)].image_path;
    if (given.empty()) return point.Images();
    const fs::path relative = fs::absolute(given).lexically_relative(fs::absolute(Base(scene).root));
    return !relative.empty() && *relative.begin() != ".." ? point.root / relative : fs::absolute(given);
  }

  // motion_splitter looks for features again where their options are others than the scan's: those of the
  // scan are kept, unless the run asks for others.
  void AddFeatureOptions(int scene, std::vector<std::string>* words) const {
    Reporter silent;
    const std::optional<StageStamp> stamp = ReadStageStamp(Base(scene), "feature_extractor", silent);
    if (!stamp) return;
    for (const auto& [name, value] : stamp->options) {
      if (value.empty() || std::find(words->begin(), words->end(), "--" + name) != words->end()) continue;
      words->push_back("--" + name);
      words->push_back(value);
    }
  }

  // What all runs are given goes before what the knob asks of them.
  bool IsGiven(const std::string& option) const {
    return std::any_of(o_.arguments.begin(), o_.arguments.end(), [&](const std::string& argument) {
      return argument.substr(0, argument.find('=')) == option;
    });
  }

  // What a value sets goes before what all runs are given.
  bool IsSetBy(const std::string& value, const std::string& command, const std::string& option) const {
    for (const KnobSetting& setting : o_.knob.settings) {
      if (setting.value != value || setting.command != command) continue;
      for (const auto& set : setting.options) {
        if (set.first == option) return true;
      }
    }
    return false;
  }

  // \param value  null: the command's default.
  ChildExit RunCommand(const std::string& command, int scene, const Workspace& point, uint64_t seed,
                       const std::vector<std::string>& more, const std::string* value) {
    std::vector<std::string> words = {o_.program.string(), command};
    const auto add = [&words](const std::string& name, const std::string& text) {
      words.push_back("--" + name);
      words.push_back(text);
    };
    if (command == "motion_splitter") {
      add("database_path", point.Database().string());
    } else {
      add("workspace_path", point.root.string());
    }
    if (command != "tsdf_mesher" && command != "scan_evaluator") {
      add("image_path", ImagePath(scene, point).string());
    }
    if (command == "gaussian_trainer" || command == "gaussian_renderer" || command == "tsdf_mesher") {
      add("use_gpu", o_.use_gpu);
    }
    add("random_seed", std::to_string(seed));
    if (command == o_.knob.command) {
      for (const std::string& argument : o_.arguments) {
        const size_t equals = argument.find('=');
        if (value != nullptr && IsSetBy(*value, command, argument.substr(0, equals))) continue;
        add(argument.substr(0, equals), InWorkspace(argument.substr(equals + 1), Base(scene)));
      }
      for (const auto& [name, text] : o_.knob.fixed) {
        if (!IsGiven(name)) add(name, text);
      }
      if (value != nullptr && o_.knob.settings.empty()) add(o_.knob.option, *value);
    }
    for (const KnobSetting& setting : o_.knob.settings) {
      if (value == nullptr || setting.value != *value || setting.command != command) continue;
      for (const auto& [name, text] : setting.options) add(name, text);
    }
    if (command == "motion_splitter") AddFeatureOptions(scene, &words);
    words.insert(words.end(), more.begin(), more.end());
    std::string output;
    const ChildExit end = RunChild(
        {words, {}}, {},
        [&output](const ChildOutput& line) {
          if (line.is_complete) output += std::string(line.line) + "\n";
        },
        [this] { return reporter_.StopRequested(); });
    const fs::path log = point.root / "run.log";
    const std::string before = Exists(log) ? ReadWholeFile(log, uint64_t{1} << 28U) : "";
    WriteFileAtomically(log, [&](std::ostream& out) {
      out << before;
      for (const std::string& word : words) out << word << ' ';
      out << '\n' << output;
    });
    if (end.exit_code == 130) throw Interrupted();
    return end;
  }

  // Why a command failed: its message, or the last line that says something.
  static std::string Reason(const fs::path& log) {
    std::string text = ReadWholeFile(log, uint64_t{1} << 28U);
    while (!text.empty() && text.back() == '\n') text.pop_back();
    const size_t message = ("\n" + text).rfind("\n" + std::string(kErrorMark));
    const size_t last = text.rfind('\n');
    if (message == std::string::npos) return last == std::string::npos ? text : text.substr(last + 1);
    std::replace(text.begin(), text.end(), '\n', ' ');
    return text.substr(message + kErrorMark.size());
  }

  WorkPoint MakePoint(const Run& run) {
    const Workspace point_workspace = PointWorkspace(run);
    const fs::path file = point_workspace.root / "point.json";
    const std::string settings = SettingsText(run);
    if (std::optional<WorkPoint> known = ReadPoint(file, settings)) {
      known->scene = run.scene;
      return *known;
    }
    WorkPoint point;
    point.scene = run.scene;
    point.value = run.value;
    point.seed = run.seed;
    MakePointWorkspace(SeedBase(run.scene, run.seed), o_.knob.from, point_workspace);
    for (const std::string& command : o_.knob.commands) {
      const double started = SteadySeconds();
      const ChildExit end = RunCommand(command, run.scene, point_workspace, run.seed, {}, &run.value);
      point.wall_seconds += SteadySeconds() - started;
      point.cpu_seconds += end.cpu_seconds;
      if (!end.Succeeded()) {
        // What a program that a signal ended said last is not why.
        point.failure = command + ": " +
                        (end.signal != 0 ? "ended by signal " + std::to_string(end.signal)
                                         : Reason(point_workspace.root / "run.log"));
        break;
      }
    }
    if (point.failure.empty()) Measure(run, point_workspace, &point);
    WritePoint(file, settings, point);
    if (!o_.keep_files) ThinPointWorkspace(point_workspace);
    return point;
  }

  // By what needs no other run.
  void Measure(const Run& run, const Workspace& workspace, WorkPoint* point) {
    const fs::path& truth = o_.scenes[static_cast<size_t>(run.scene)].ground_truth;
    if (!truth.empty()) {
      const fs::path figures = workspace.root / "figures.json";
      RunCommand("scan_evaluator", run.scene, workspace, 0,
                 {"--ground_truth_path", fs::absolute(truth).string(), "--json_path", figures.string()},
                 nullptr);
      point->figures = EvaluatedFigures(figures);
    }
    if (o_.knob.stage == KnobStage::kTraining) {
      for (const auto& [name, value] : TrainingFigures(workspace)) point->figures[name] = value;
    }
    if (o_.knob.stage == KnobStage::kTraining) return;
    for (const auto& [name, value] : OwnFigures(workspace)) point->figures[name] = value;
  }

  // By the last value's run of the same seed.
  void MeasureByRuler(std::vector<WorkPoint>* points) {
    ParallelFor(static_cast<int64_t>(points->size()), o_.jobs, [&](int64_t i) {
      WorkPoint& point = (*points)[static_cast<size_t>(i)];
      if (!point.failure.empty() || point.value == o_.values.back()) return;
      const Workspace own = PointWorkspace({point.scene, point.value, point.seed});
      const Workspace ruler = PointWorkspace({point.scene, o_.values.back(), point.seed});
      const auto found =
          o_.knob.stage == KnobStage::kPoses ? PosesAgainst(own, ruler) : MeshAgainst(own, ruler);
      for (const auto& [name, value] : found) point.figures[name] = value;
    });
  }

  WorkCurve CurveOf(std::vector<WorkPoint> points) const {
    const KnobError error = !has_truth_ && !o_.knob.settings.empty() ? OwnErrorOf(o_.knob.stage)
                                                                     : ErrorOf(o_.knob.stage, has_truth_);
    WorkCurve curve;
    curve.knob = o_.knob.name;
    curve.what = o_.knob.what;
    curve.error = error.figure;
    curve.error_text = error.text;
    curve.reference = o_.knob.stage == KnobStage::kTraining ? "photos held out of training"
                      : has_truth_                          ? "ground truth"
                      : !o_.knob.settings.empty()           ? "what the run says of itself"
                                                  : "the scan's own longest run, " + o_.values.back();
    curve.program = Version();
    for (size_t scene = 0; scene < o_.scenes.size(); ++scene) {
      curve.scenes.push_back(SceneName(static_cast<int>(scene)));
    }
    curve.values = o_.values;
    if (needs_ruler_) {
      curve.values.pop_back();
      points.erase(std::remove_if(points.begin(), points.end(),
                                  [&](const WorkPoint& point) { return point.value == o_.values.back(); }),
                   points.end());
    }
    for (WorkPoint& point : points) {
      if (point.failure.empty() && !point.Figure(curve.error))
        point.failure = "the result could not be measured";
    }
    curve.points = std::move(points);
    return curve;
  }

  SweepOptions o_;
  Reporter& reporter_;
  bool has_truth_ = true;
  bool needs_ruler_ = false;
  std::mutex mutex_;
};

}  // namespace

WorkCurve RunSweep(const SweepOptions& options, Reporter& reporter) {
  return Sweep(options, reporter).Make();
}

}  // namespace s2gs
