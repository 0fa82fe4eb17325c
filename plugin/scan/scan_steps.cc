#include "plugin/scan/scan_steps.h"

#include <filesystem>
#include <utility>

#include "plugin/plan/plan_parts.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

// Features per photo. Fewer would leave out small scales, which is where objects have theirs.
int MaxNumFeatures(Quality quality) { return quality == Quality::kExtreme ? 16384 : 8192; }

const char* LogLevelName(LogLevel level) {
  switch (level) {
    case LogLevel::kDebug:
      return "debug";
    case LogLevel::kInfo:
      return "info";
    case LogLevel::kWarning:
      return "warning";
    case LogLevel::kError:
      return "error";
  }
  return "";
}

// With what every command takes.
ScanStep MakeStep(const std::string& command, const std::string& title, std::vector<std::string> arguments,
                  const ScanSettings& settings) {
  const std::vector<std::string> common = {"--random_seed", std::to_string(settings.random_seed),
                                           "--log_level", LogLevelName(settings.log_level)};
  arguments.insert(arguments.end(), common.begin(), common.end());
  return {command, title, std::move(arguments)};
}

// An option that is left out where it has no value.
std::vector<std::string> With(std::vector<std::string> arguments, const std::string& name,
                              const std::string& value) {
  if (!value.empty()) arguments.insert(arguments.end(), {name, value});
  return arguments;
}

std::vector<std::string> TrainingArguments(const ScanSettings& settings) {
  std::vector<std::string> training = {"--workspace_path", settings.workspace_path.string(),
                                       "--image_path",     settings.image_path.string(),
                                       "--use_gpu",        settings.use_gpu,
                                       "--quality",        QualityName(settings.quality),
                                       "--test_every",     std::to_string(settings.test_every)};
  training = With(training, "--mask_path", settings.mask_path.string());
  if (settings.num_iterations) {
    training = With(training, "--Train.num_iterations", FormatValue(*settings.num_iterations));
  }
  if (settings.max_image_size) {
    training = With(training, "--max_image_size", FormatValue(*settings.max_image_size));
  }
  return training;
}

}  // namespace

ScanStep ReportStep(const ScanSettings& settings) {
  return MakeStep(
      "report", "The report",
      {"--workspace_path", settings.workspace_path.string(), "--image_path", settings.image_path.string()},
      settings);
}

std::vector<ScanStep> ScanSteps(const ScanSettings& settings) {
  const Workspace workspace{settings.workspace_path};
  const std::string root = settings.workspace_path.string();
  const std::string images = settings.image_path.string();
  std::vector<ScanStep> steps;
  const auto add = [&](const std::string& command, const std::string& title,
                       std::vector<std::string> arguments) {
    const std::vector<std::string> forced = ForcedArguments(command, settings.forced);
    arguments.insert(arguments.end(), forced.begin(), forced.end());
    steps.push_back(MakeStep(command, title, std::move(arguments), settings));
  };
  if (settings.Imports()) {
    std::vector<std::string> arguments = {"--workspace_path", root, "--image_path",
                                          settings.given_path.string()};
    if (settings.is_video)
      arguments = With(arguments, "--video_frames", std::to_string(settings.video_frames));
    add("photo_importer", "Photos that COLMAP reads",
        With(arguments, "--ffmpeg_path", settings.ffmpeg_path.string()));
  }
  add("motion_splitter", "What stands still and what turns",
      With(With(With(With({"--database_path", workspace.Database().string(), "--image_path", images,
                           "--SiftExtraction.max_num_features",
                           std::to_string(MaxNumFeatures(settings.quality))},
                          "--SiftExtraction.first_octave",
                          settings.first_octave ? std::to_string(*settings.first_octave) : ""),
                     "--ImageReader.camera_params", settings.camera_params),
                "--mask_path", settings.forced.count("motion") > 0 ? "" : settings.mask_path.string()),
           "--colmap_path", settings.colmap_path.string()));
  add("turntable_mapper", "Cameras, table, and both sparse models",
      With(With(With({"--workspace_path", root, "--image_path", images}, "--colmap_path",
                     settings.colmap_path.string()),
                "--angles_path", settings.angles_path.string()),
           "--step_deg", settings.step_deg != 0 ? FormatValue(settings.step_deg) : ""));
  if (settings.scale.HasAny()) {
    std::vector<std::string> arguments = ScaleArguments(settings.scale);
    arguments.insert(arguments.begin(), {"--workspace_path", root, "--image_path", images});
    add("model_scaler", "Millimetres", std::move(arguments));
  }
  if (settings.until == ScanUntil::kSplit) return steps;

  add("gaussian_trainer", "The Gaussian model", TrainingArguments(settings));
  if (settings.until == ScanUntil::kTrain) return steps;

  add("gaussian_renderer", "Masks, depth and normal maps",
      {"--workspace_path", root, "--image_path", images, "--use_gpu", settings.use_gpu, "--plain_table",
       settings.plain_table});
  std::vector<std::string> meshing = {"--workspace_path",
                                      root,
                                      "--use_gpu",
                                      settings.use_gpu,
                                      "--Cleanup.remove_disc",
                                      settings.keep_disc ? "0" : "1"};
  // Meshes of such models err over more than light tells of their forms.
  if (settings.IsLow()) meshing.insert(meshing.end(), {"--Refine.shading", "0"});
  add("tsdf_mesher", "The mesh", std::move(meshing));
  if (settings.texture) {
    add("mesh_texturer", "The photos' colours on the mesh",
        {"--workspace_path", root, "--test_every", std::to_string(settings.test_every)});
  }
  return steps;
}

ScanRequest RequestOf(const ScanSettings& settings, const std::vector<ScanStep>& steps) {
  ScanRequest request;
  request.workspace = Workspace{settings.workspace_path};
  request.image_path = settings.given_path;
  request.import = settings.import;
  request.is_video = settings.is_video;
  request.ffmpeg_path = settings.ffmpeg_path;
  request.mask_path = settings.mask_path;
  request.angles_path = settings.angles_path;
  request.colmap_path = settings.colmap_path;
  request.use_gpu = settings.use_gpu;
  request.test_every = settings.test_every;
  request.num_iterations = settings.num_iterations;
  request.max_image_size = settings.max_image_size;
  request.max_num_features = MaxNumFeatures(settings.quality);
  request.trains = settings.until != ScanUntil::kSplit;
  request.meshes = settings.until == ScanUntil::kMesh;
  request.textures = request.meshes && settings.texture;
  for (const ScanStep& step : steps) request.steps.emplace_back(step.command, step.arguments);
  const ScaleOptions& scale = settings.scale;
  for (const auto& [texts, option] :
       {std::pair(&scale.point_a, "point_a"), std::pair(&scale.point_b, "point_b"),
        std::pair(&scale.disc_rim, "disc_rim")}) {
    for (const PhotoPlace& place : ParsePhotoPlaces(*texts, option))
      request.marked_photos.emplace_back(place.name, option);
  }
  return request;
}

PlanRequest PlanOf(const ScanSettings& settings) {
  PlanRequest request;
  request.workspace = Workspace{settings.workspace_path};
  request.image_path = settings.image_path;
  request.has_masks = !settings.mask_path.empty();
  request.trains = settings.until != ScanUntil::kSplit;
  request.meshes = settings.until == ScanUntil::kMesh;
  request.textures = settings.texture;
  request.forced = settings.forced;
  return request;
}

}  // namespace s2gs
