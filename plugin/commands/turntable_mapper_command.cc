#include "plugin/commands/turntable_mapper_command.h"

#include <glog/logging.h>

#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <system_error>
#include <vector>

#include "plugin/colmap/attempt_beside.h"
#include "plugin/colmap/body_mapper.h"
#include "plugin/colmap/colmap_process.h"
#include "plugin/commands/turntable_mapper_options.h"
#include "plugin/mapping/turntable_mapper.h"
#include "plugin/outputs/turntable_report.h"
#include "plugin/stage/stage.h"
#include "plugin/stage/stage_stamp.h"
#include "plugin/stage/workspace.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/parallel_for.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

// The stages that a mapper's parts are, each with its stamp: those of both bodies, then the placing.
class MapperStages {
 public:
  MapperStages(const Options& options, const Workspace& workspace, TurntableMapperSettings* settings,
               Reporter& reporter)
      : options_(options),
        workspace_(workspace),
        settings_(*settings),
        reporter_(reporter),
        runner_(workspace, reporter),
        mapper_(*settings, workspace, reporter) {
    for (const auto& [name, value] : options.Values()) {
      if (name == "mapper_options" || name == "max_mapper_attempts") mapping_options_[name] = value;
    }
  }

  const TurntableMapper& mapper() const { return mapper_; }
  void Read();
  void Run();

 private:
  void Map(bool of_object, Reporter& reporter);
  void MapObject(Reporter& reporter);
  void MapBackground();
  void Place();

  const Options& options_;
  const Workspace& workspace_;
  TurntableMapperSettings& settings_;
  Reporter& reporter_;
  StageRunner runner_;
  TurntableMapper mapper_;
  std::optional<ColmapProgram> colmap_;
  std::map<std::string, std::string> mapping_options_;
};

void MapperStages::Read() {
  mapper_.ReadInput();
  mapper_.ReadStatedAngles(&settings_);
  const ScanInput& input = mapper_.input();
  if (input.reason.empty()) return;
  reporter_.Info(std::string("the split found: ") + CaptureCaseName(input.capture_case) + " (" +
                 input.reason + ")");
}

void MapperStages::Map(bool of_object, Reporter& reporter) {
  std::error_code ec;
  if (!fs::is_directory(settings_.image_path, ec)) {
    throw UserError(settings_.image_path, "no such folder of photos, which colmap mapper needs",
                    "Check --image_path");
  }
  if (!colmap_) colmap_ = ColmapProgram::Find(settings_.colmap_path, reporter);
  mapper_.Map(of_object, &*colmap_, reporter);
}

void MapperStages::MapObject(Reporter& reporter) {
  runner_.Run({"object_mapper",
               {workspace_.ObjectDatabase()},
               mapping_options_,
               {mapper_.ObjectFolder()},
               {"motion_splitter"}},
              [&] {
                if (!mapper_.TriesCircleFirst()) mapper_.BeginCircularSearch(&settings_);
                Map(true, reporter);
              });
}

void MapperStages::MapBackground() {
  runner_.Run({"background_mapper",
               {workspace_.StaticDatabase()},
               mapping_options_,
               {mapper_.BackgroundFolder()},
               {"motion_splitter"}},
              [&] {
                // What comes next depends on this stage and runs as well.
                if (mapper_.TriesCircleFirst()) mapper_.BeginCircularSearch(&settings_);
                Map(false, reporter_);
              });
}

// Whether the object has to be mapped is told by this stage's work; all that it is mapped by counts here.
void MapperStages::Place() {
  if (mapper_.TriesCircleFirst()) {
    if (settings_.placement.circular.begun == nullptr) mapper_.BeginCircularSearch(&settings_);
    AttemptBeside([&](Reporter& to) { return mapper_.PlaceByCircle(to); },
                  {[&](Reporter& to) { MapObject(to); },
                   [&] {
                     RemoveMapping(mapper_.ObjectFolder());
                     RemoveStageStamp(workspace_, "object_mapper");
                   }},
                  NumThreadsOf(0), reporter_);
  }
  mapper_.Place();
}

void MapperStages::Run() {
  std::vector<std::string> before = {"motion_splitter"};
  const PlacementPath path = settings_.placement.path;
  if (!mapper_.TriesCircleFirst() && (path == PlacementPath::kAuto || path == PlacementPath::kFreeSfm ||
                                      mapper_.input().capture_case == CaptureCase::kOneBody)) {
    MapObject(reporter_);
    before.emplace_back("object_mapper");
  }
  if (mapper_.HasBackground()) {
    MapBackground();
    before.emplace_back("background_mapper");
  }
  std::vector<fs::path> inputs = {workspace_.ObjectDatabase(), workspace_.StaticDatabase()};
  if (!settings_.angles_path.empty()) inputs.push_back(settings_.angles_path);
  inputs.push_back(settings_.image_path);
  runner_.Run({"turntable_mapper",
               inputs,
               ValuesWithout(options_, {"workspace_path", "image_path", "colmap_path", "angles_path"}),
               {workspace_.ObjectModel(), workspace_.Turntable(), mapper_.ReportPath()},
               before,
               {workspace_.StaticModel(), mapper_.ReportPath().parent_path()}},
              [&] { Place(); });
}

}  // namespace

void RunTurntableMapper(CommandContext& context) {
  TurntableMapperSettings settings;
  Options& options = context.Declare(
      "Runs `colmap mapper` on both databases of motion_splitter, finds the table's axis, angles and the "
      "scale "
      "between the two models, takes back the photos that were left out, adjusts everything together, and "
      "writes "
      "it in one frame: sparse/0 (the object held still), sparse/static (the background) and turntable.json.",
      "--workspace_path scan --image_path scan/images");
  AddTurntableMapperOptions(options, &settings);
  Reporter& reporter = context.Parse();
  FLAGS_minloglevel = google::GLOG_FATAL;  // Ceres reports each step that it takes back
  const auto seed = static_cast<uint32_t>(options.random_seed());
  settings.placement.turntable.random_seed = seed;
  settings.placement.single_axis.random_seed = seed;
  settings.placement.circular.random_seed = seed;

  const Workspace workspace{settings.workspace_path};
  if (settings.image_path.empty()) settings.image_path = workspace.Images();
  MapperStages stages(options, workspace, &settings, reporter);
  stages.Read();
  stages.Run();
  PrintTurntableSummary(stages.mapper().ReportPath(), context.out());
}

}  // namespace s2gs
