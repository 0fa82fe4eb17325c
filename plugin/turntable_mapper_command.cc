#include "plugin/turntable_mapper_command.h"

#include <filesystem>
#include <iomanip>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "plugin/colmap_process.h"
#include "plugin/workspace.h"
#include "sfm_split/align_scene.h"
#include "sfm_split/colmap_database.h"
#include "sfm_split/colmap_model.h"
#include "sfm_split/error.h"
#include "sfm_split/file_io.h"
#include "sfm_split/turntable_file.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

constexpr uint64_t kMaxLabelsBytes = uint64_t{1} << 30;

// Station by image name, from the split's labels.json.
std::map<std::string, int> ReadStations(const fs::path& path) {
  const std::string remedy = "Run `s2gs motion_splitter` first";
  const std::string text = ReadWholeFile(path, kMaxLabelsBytes, remedy);
  std::map<std::string, int> stations;
  try {
    const nlohmann::json file = nlohmann::json::parse(text);
    for (const nlohmann::json& image : file.at("images")) {
      stations[image.at("name").get<std::string>()] = image.at("station").get<int>();
    }
  } catch (const nlohmann::json::exception& error) {
    throw UserError(path, std::string("is damaged: ") + error.what(), remedy);
  }
  return stations;
}

bool HasTwoViewGeometries(const fs::path& database_path) {
  const ColmapDatabase database = ColmapDatabase::Open(database_path, ColmapDatabase::Access::kReadOnly);
  bool found = false;
  database.ForEachTwoViewGeometry([&](uint32_t, uint32_t, const TwoViewGeometry&) { found = true; });
  return found;
}

// Of the models that the mapper left in numbered folders, the one with most images.
std::optional<ColmapModel> LargestModel(const fs::path& folder) {
  std::optional<ColmapModel> largest;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder)) {
    if (!entry.is_directory()) continue;
    ColmapModel model = ReadColmapModel(entry.path());
    if (!largest || model.images.size() > largest->images.size()) largest = std::move(model);
  }
  return largest;
}

struct Mapping {
  fs::path database;
  fs::path images;
  fs::path output;
  int min_model_size = 10;
};

ColmapModel RunMapper(const Mapping& mapping, ColmapProgram* colmap, Reporter& reporter) {
  std::error_code ec;
  fs::remove_all(mapping.output, ec);
  CreateFolder(mapping.output);
  colmap->Run({"mapper",
               {{"database_path", mapping.database.string()},
                {"image_path", mapping.images.string()},
                {"output_path", mapping.output.string()},
                {"Mapper.min_model_size", std::to_string(mapping.min_model_size)}},
               {{mapping.output / "0"}}},
              reporter);
  std::optional<ColmapModel> model = LargestModel(mapping.output);
  if (!model || model->images.empty()) {
    throw UserError(mapping.output, "colmap mapper left no model",
                    "Look at its output with --log_level debug");
  }
  return std::move(*model);
}

TurntableFile ToTurntableFile(const TurntableScene& scene) {
  TurntableFile file;
  file.axis = scene.axis;
  file.num_stations = scene.num_stations;
  file.scale_observable = scene.scale_observable;
  file.units = scene.units;
  for (const View& view : scene.views) {
    file.images.push_back({view.name, view.station, view.angle_deg, view.world_from_object});
  }
  return file;
}

void CheckAligned(const AlignedScene& aligned, const fs::path& database) {
  if (!aligned.scene.views.empty()) return;
  throw UserError(database,
                  std::string("the two models do not make a turntable: ") +
                      TurntableMotionName(aligned.solution.motion) + " (" +
                      std::to_string(aligned.poses.size()) + " images in both, table angles spread by " +
                      std::to_string(aligned.solution.angle_spread_deg) + " degrees, relative rotations +- " +
                      std::to_string(aligned.solution.rotation_sigma_deg) + " degrees)",
                  "Look at the models in split/ with `colmap gui` or `colmap model_analyzer`");
}

void PrintSummary(const AlignedScene& aligned, size_t num_images, std::ostream& out) {
  const TurntableSolution& solution = aligned.solution;
  out << std::setprecision(4) << "images in both models  " << aligned.scene.views.size() << " of "
      << num_images << '\n'
      << "object points          " << aligned.object.points3D.size() << '\n'
      << "background points      " << aligned.background.points3D.size() << '\n'
      << "stations               " << aligned.scene.num_stations << '\n'
      << "median step            " << solution.median_step_deg << " degrees\n"
      << "relative rotations     +- " << solution.rotation_sigma_deg << " degrees\n"
      << "axis                   +- " << solution.axis_sigma_deg << " degrees\n";
  if (aligned.scene.scale_observable) {
    out << "object / background    +- " << 100 * solution.scale_sigma_rel << " % of scale\n";
  } else {
    out << "object / background    scale cannot be observed from one station\n";
  }
  for (const std::string& name : aligned.left_out) out << "left out               " << name << '\n';
}

}  // namespace

void RunTurntableMapper(CommandContext& context) {
  fs::path workspace_path;
  fs::path image_path;
  fs::path colmap_path;
  Options& options = context.Declare(
      "Runs `colmap mapper` on both databases of motion_splitter, finds the table's axis, angles and the "
      "scale "
      "between the two models, and writes them in one frame: sparse/0 (the object held still), sparse/static "
      "(the background) and turntable.json.",
      "--workspace_path scan --image_path scan/images");
  options.Add("workspace_path", &workspace_path, "the workspace, with split/ from motion_splitter")
      .Required();
  options.Add("image_path", &image_path, "the photos; empty: images in the workspace");
  options.Add("colmap_path", &colmap_path,
              "the colmap executable or its folder; empty: searched for on PATH");
  Reporter& reporter = context.Parse();

  const Workspace workspace{workspace_path};
  const WorkspaceLock lock(workspace, reporter);
  const std::map<std::string, int> stations =
      ReadStations(workspace.ObjectDatabase().parent_path() / "labels.json");
  if (image_path.empty()) image_path = workspace.Images();

  ColmapProgram colmap = ColmapProgram::Find(colmap_path, reporter);
  reporter.Info("mapping the rotating part with colmap " + colmap.version());
  const fs::path split = workspace.ObjectDatabase().parent_path();
  const ColmapModel object =
      RunMapper({workspace.ObjectDatabase(), image_path, split / "object_model", 3}, &colmap, reporter);
  std::optional<ColmapModel> background;
  if (HasTwoViewGeometries(workspace.StaticDatabase())) {
    reporter.Info("mapping the background");
    background =
        RunMapper({workspace.StaticDatabase(), image_path, split / "static_model", 2}, &colmap, reporter);
  } else {
    reporter.Info("one station: the background needs no model, the world is the camera's frame");
  }

  const AlignedScene aligned = AlignScene(object, background ? &*background : nullptr, stations);
  CheckAligned(aligned, workspace.ObjectDatabase());
  CreateFolder(workspace.ObjectModel());
  WriteColmapModel(workspace.ObjectModel(), aligned.object, ColmapFormat::kBinary);
  if (!aligned.background.images.empty()) {
    CreateFolder(workspace.StaticModel());
    WriteColmapModel(workspace.StaticModel(), aligned.background, ColmapFormat::kBinary);
  }
  WriteTurntableFile(workspace.Turntable(), ToTurntableFile(aligned.scene));
  PrintSummary(aligned, stations.size(), context.out());
}

}  // namespace s2gs
