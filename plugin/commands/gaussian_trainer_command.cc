#include "plugin/commands/gaussian_trainer_command.h"

#define XXH_INLINE_ALL
#include <fmt/format.h>
#include <xxhash.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <initializer_list>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "plugin/shared_options/backend_choice.h"
#include "plugin/shared_options/quality.h"
#include "plugin/stage/stage.h"
#include "plugin/stage/workspace.h"
#include "s2gs/gaussians_ply.h"
#include "s2gs/scene/scene_lengths.h"
#include "s2gs/scene/training_scene.h"
#include "s2gs/training/train.h"
#include "s2gs/training_memory.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/machine_share.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

const EnumNames<TrainMode> kModeNames = {{"auto", TrainMode::kAuto},
                                         {"s2gs", TrainMode::kS2gs},
                                         {"masks", TrainMode::kMasks},
                                         {"static", TrainMode::kStatic}};
const EnumNames<InitialPoints> kInitNames = {{"sparse", InitialPoints::kSparse},
                                             {"random", InitialPoints::kRandom}};
const EnumNames<GrowthStrategy> kGrowthNames = {{"adaptive", GrowthStrategy::kAdaptive},
                                                {"budget", GrowthStrategy::kBudget}};
const EnumNames<GaussianPlyLayout> kLayoutNames = {{"2dgs", GaussianPlyLayout::k2dgs},
                                                   {"3dgs", GaussianPlyLayout::k3dgs}};

// What --quality stands for, where the options themselves are not given, in the order of Preset.
constexpr std::array<const char*, 5> kPresetOptions = {
    "Train.num_iterations", "max_image_size", "Train.growth", "Train.max_gaussians", "Train.whole_every"};
struct Preset {
  int64_t num_iterations;
  int max_image_size;
  GrowthStrategy growth;
  int64_t max_gaussians;
  int whole_every;  // on a CPU steps cost by their pixels, on a GPU hardly.
};

Preset PresetOf(Quality quality) {
  switch (quality) {
    case Quality::kLow:
      return {6'000, 240, GrowthStrategy::kBudget, 30'000, 4};
    case Quality::kMedium:
      return {10'000, 800, GrowthStrategy::kAdaptive, 500'000, 1};
    case Quality::kExtreme:
      return {60'000, 3200, GrowthStrategy::kAdaptive, 6'000'000, 1};
    default:
      return {30'000, 1600, GrowthStrategy::kAdaptive, 2'000'000, 1};
  }
}

struct Arguments {
  fs::path workspace_path;
  fs::path image_path;
  fs::path mask_path;
  fs::path truth_mask_path;
  fs::path output_path;
  Quality quality = Quality::kAuto;
  GaussianPlyLayout ply_layout = GaussianPlyLayout::k2dgs;
  bool foreground_only = false;
  bool resume = true;
  int64_t host_memory_mb = 0;  // 0: what is free
  int64_t gpu_memory_mb = 0;
  TrainingSceneOptions scene;
  TrainOptions train;
  BackendChoice backend;
};

void AddSceneOptions(Options* options, Arguments* a) {
  options->Add("workspace_path", &a->workspace_path, "the workspace, with sparse/0 and turntable.json")
      .Required();
  options->Add("image_path", &a->image_path, "the photos; empty: images in the workspace");
  options->Add("mask_path", &a->mask_path,
               "masks NAME.png of the rotating part; empty: masks in the workspace, for --mode masks and "
               "--masks_as_hint only");
  options->Add("output_path", &a->output_path,
               "folder for point_cloud.ply, log and checkpoints; empty: s2gs in the workspace");
  options->AddEnum(
      "quality", &a->quality, kQualityNames,
      "sets iterations, photo size, growth, count and how often whole frames are learnt from, where they are "
      "not given; auto: high on a GPU, low on the CPU");
  auto scene = options->Fields(&a->scene);
  scene.AddEnum(
      "mode", &TrainingSceneOptions::mode, kModeNames,
      "s2gs: tell the rotating part from the background by motion; masks: 2DGS of the rotating part cut "
      "out by masks; static: 2DGS of everything; auto: s2gs when turntable.json says that something "
      "turns, else masks when --mask_path has some, else static");
  scene.Add("max_image_size", &TrainingSceneOptions::max_image_size, "longer side of photos in training")
      .Unit("px");
  scene.Add(
      "equalise_exposure", &TrainingSceneOptions::equalise_exposure,
      "divide photos of a camera that stands still by what its automatic exposure and white balance did");
  scene.Add("masks_as_hint", &TrainingSceneOptions::masks_as_hint,
            "in mode s2gs: draw p towards the masks there are");
  options->Add("resume", &a->resume, "go on from the last checkpoint, if options and photos are the same");
  options->Add("foreground_only", &a->foreground_only, "write only the Gaussians of the rotating part");
  options
      ->Add("host_memory", &a->host_memory_mb,
            "what training may take: the peak is stated before it starts, and the model grows no larger than "
            "fits; "
            "0: what is free")
      .Unit("MB");
  options->Add("gpu_memory", &a->gpu_memory_mb, "the same of the GPU's memory").Unit("MB");
  options->AddEnum("ply_layout", &a->ply_layout, kLayoutNames,
                   "2dgs: two scales, for s2gs and 2DGS; 3dgs: a third one, for viewers of 3D Gaussians");
  options->Section("HeldOut", "photos that training leaves out, to measure by", [&] {
    scene.Add("test_every", &TrainingSceneOptions::test_every,
              "hold out every n-th photo by name, to measure by; 0: none");
    scene.Add("test_list", &TrainingSceneOptions::test_list,
              "file with the names of held-out photos, one a line");
    scene
        .Add(
            "max_test_size", &TrainingSceneOptions::max_test_size,
            "longer side of held-out photos, so that runs with photos of different sizes are measured alike; "
            "0: as in training")
        .Unit("px");
    options->Add("truth_mask_path", &a->truth_mask_path,
                 "masks NAME.png to measure held-out photos by; never trained on");
  });
}

void AddTrainOptions(Options* options, TrainOptions* train) {
  auto group = options->Group(
      "Train", train, "how long training goes on, how many Gaussians there are, weights of the losses");
  using T = TrainOptions;
  group.Add("num_iterations", &T::num_iterations, "steps, one photo each");
  group.Add("max_seconds", &T::max_seconds, "run through the whole course in this time at most; 0: no bound")
      .Unit("s");
  group
      .Add("stop_gain_pct", &T::stop_gain_pct,
           "stop when held-out photos would gain less over the rest of the run; 0: never")
      .Unit("%");
  group.Add("normal_weight", &T::normal_weight, "weight of agreement between normals and depth");
  group.Add("distortion_weight", &T::distortion_weight, "weight of depth distortion");
  group.Add("local_consistency_weight", &T::local_consistency_weight,
            "weight of agreement of p between neighbours");
  group.Add("entropy_3d_weight", &T::entropy_3d_weight, "weight of the entropy of p of Gaussians");
  group.Add("entropy_2d_weight", &T::entropy_2d_weight, "weight of the entropy of p in the images");
  group.Add("sh_degree", &T::sh_degree, "highest band of view-dependent colour");
  group.Add("only_told_bands", &T::only_told_bands,
            "leave out bands that no training photo tells from lower ones");
  group.AddEnum(
      "growth", &T::growth, kGrowthNames,
      "adaptive: wherever gradients are large; budget: where they are largest, up to a fixed count");
  group.Add("max_gaussians", &T::max_gaussians, "no more Gaussians than these");
  group.Add("densify_every", &T::densify_every, "iterations between two steps of growth");
  group.Add("settle_from", &T::settle_from,
            "p is frozen from here on as soon as it has settled, as share of the run");
  group.Add("settle_until", &T::settle_until, "p is frozen here at the latest; 1: never");
  group.Add("use_turn_evidence", &T::use_turn_evidence,
            "nothing rotates where photos of a camera that stands still show the background's texture");
  group.Add("unseen_static_weight", &T::unseen_static_weight,
            "the same for Gaussians that stand still; half a grey level is what no photo shows");
  group.Add(
      "whole_every", &T::whole_every,
      "with p frozen and growth over, whole frames are learnt from in one of so many rounds through the "
      "photos, in the others only tiles that the rotating part reaches; 1: always");
  group.Add("checkpoint_every", &T::checkpoint_every,
            "as share of the run, where 30 s or more would be lost; 0: only when interrupted");
  group.Add("num_measurements", &T::num_measurements, "of held-out photos, at log-spaced moments; 0: none");
}

void AddInitialiseOptions(Options* options, InitialiseOptions* initial) {
  auto group = options->Group("Init", initial, "the Gaussians that training begins with");
  using I = InitialiseOptions;
  group.AddEnum(
      "init", &I::init, kInitNames,
      "sparse: the points of the sparse models, filled up with random ones; random: a random cube and "
      "sphere, as in the paper");
  group.Add("num_random_points", &I::num_random_points, "with random");
  group.Add("min_points", &I::min_points, "with sparse: filled up to this many for each body");
  group.Add("max_points", &I::max_points, "with sparse: no more than these");
}

void ApplyPreset(const Options& options, BackendKind kind, Arguments* a) {
  Quality quality = a->quality;
  if (quality == Quality::kAuto) quality = kind == BackendKind::kCuda ? Quality::kHigh : Quality::kLow;
  const Preset preset = PresetOf(quality);
  if (!options.IsGiven(kPresetOptions[0])) a->train.num_iterations = preset.num_iterations;
  if (!options.IsGiven(kPresetOptions[1])) a->scene.max_image_size = preset.max_image_size;
  if (!options.IsGiven(kPresetOptions[2])) a->train.growth = preset.growth;
  if (!options.IsGiven(kPresetOptions[3])) a->train.max_gaussians = preset.max_gaussians;
  if (!options.IsGiven(kPresetOptions[4])) a->train.whole_every = preset.whole_every;
}

// Of all that is trained on.
uint64_t HashOf(const TrainingScene& scene) {
  XXH3_state_t state;
  XXH3_64bits_reset(&state);
  const auto add = [&](const void* data, size_t size) { XXH3_64bits_update(&state, data, size); };
  const auto add_pose = [&](const Rigid3& pose) {
    add(pose.rotation.coeffs().data(), 4 * sizeof(double));
    add(pose.translation.data(), 3 * sizeof(double));
  };
  for (const ScenePhoto& photo : scene.photos) {
    if (photo.held_out) continue;
    add(photo.name.data(), photo.name.size());
    add(photo.image.pixels.data(), photo.image.pixels.size());
    add(photo.mask.data(), photo.mask.size());
    add_pose(photo.view.cam_from_world);
    add_pose(photo.view.cam_from_object);
    for (const double value : {photo.view.fx, photo.view.fy, photo.view.cx, photo.view.cy}) {
      add(&value, sizeof(value));
    }
  }
  for (const ScenePoint& point : scene.points) {
    add(point.x.data(), 3 * sizeof(double));
    add(point.rgb.data(), 3);
    add(&point.rotates, sizeof(point.rotates));
  }
  return XXH3_64bits_digest(&state);
}

// Everything that a checkpoint must agree with to be gone on from.
std::string SettingsOf(const Options& options, const TrainingScene& scene) {
  std::string settings = std::string("mode=") + TrainModeName(scene.mode) + "\n";
  for (const char* group : {"Train", "Init"}) {
    for (const auto& [name, value] : options.Values(group)) {
      if (name == "Train.checkpoint_every" || name == "Train.num_measurements") continue;
      settings += name;
      settings += '=';
      settings += value;
      settings += '\n';
    }
  }
  settings += fmt::format("scene={:016x}\n", HashOf(scene));
  return settings;
}

// What results depend on; where and with how many threads they are computed does not count. Presets count by
// their name, so that a finished model stays when the workspace moves to a machine with another backend.
std::map<std::string, std::string> StageOptions(const Options& options) {
  std::map<std::string, std::string> values =
      ValuesWithout(options, {"workspace_path", "image_path", "mask_path", "truth_mask_path", "test_list",
                              "output_path", "use_gpu", "gpu_index", "num_threads", "host_memory",
                              "gpu_memory", "resume", "Train.checkpoint_every"});
  for (const char* name : kPresetOptions) {
    if (!options.IsGiven(name)) values[name] = "of quality " + values.at("quality");
  }
  values.erase("quality");
  return values;
}

// p in the file is what the mode says, where it is not learnt: in a static scene the object is what the
// photos look at, and all of it when they look at no common place.
Gaussians ForFile(Gaussians gaussians, const TrainingScene& scene) {
  constexpr float kCertainLogit = 10;
  for (size_t i = 0; scene.bodies() != SceneBodies::kBoth && i < gaussians.size(); ++i) {
    const float* centre = gaussians.centre.data() + 3 * i;
    const Eigen::Vector3d x(centre[0], centre[1], centre[2]);
    const bool is_object = scene.bodies() == SceneBodies::kObjectOnly || !(scene.focus_radius > 0) ||
                           (x - scene.focus).norm() < scene.focus_radius;
    gaussians.foreground_logit[i] = is_object ? kCertainLogit : -kCertainLogit;
  }
  return DenormaliseGaussians(std::move(gaussians), scene.origin, scene.size);
}

MemoryLimits LimitsOf(const Arguments& a, const BackendInfo& info) {
  constexpr int64_t kMegabyte = 1'000'000;
  constexpr auto kUnknown = static_cast<uint64_t>(std::numeric_limits<int64_t>::max());
  MemoryLimits limits;
  limits.host = static_cast<int64_t>(std::min(AvailableMemoryBytes(), kUnknown));
  limits.device = info.free_device_bytes;
  if (a.host_memory_mb > 0) limits.host = std::min(limits.host, a.host_memory_mb * kMegabyte);
  if (a.gpu_memory_mb > 0) limits.device = std::min(limits.device, a.gpu_memory_mb * kMegabyte);
  return limits;
}

std::string Shown(double value, const char* unit) {
  return std::isfinite(value) ? fmt::format("{:.4g}{}", value, unit) : std::string("not measured");
}

void PrintSummary(const TrainResult& result, const TrainingScene& scene, const fs::path& path,
                  std::ostream& out) {
  out << fmt::format("mode                  {}\n", TrainModeName(scene.mode))
      << fmt::format("photos                {}\n", scene.photos.size())
      << fmt::format("iterations            {}\n", result.iterations)
      << fmt::format("seconds               {:.1f} (CPU {:.1f}; measuring besides {:.1f})\n",
                     result.wall_seconds, result.cpu_seconds, result.measuring_seconds)
      << fmt::format("Gaussians             {}\n", result.gaussians.size());
  if (result.held_out) {
    const HeldOutErrors& errors = *result.held_out;
    out << fmt::format("held-out photos       {}\n", errors.num_photos)
        << fmt::format("PSNR                  {}\n", Shown(errors.psnr, " dB"))
        << fmt::format("SSIM                  {}\n", Shown(errors.ssim, ""))
        << fmt::format("PSNR, rotating part   {}\n", Shown(errors.object_psnr, " dB"))
        << fmt::format("SSIM, rotating part   {}\n", Shown(errors.object_ssim, ""))
        << fmt::format("mask IoU              {}\n", Shown(errors.mask_iou, ""));
  }
  out << "model                 " << path.string() << '\n';
}

Options& DeclareOptions(CommandContext& context, Arguments* a) {
  Options& options = context.Declare(
      "Trains 2D Gaussian splats on posed photos and tells the rotating part from the background by its "
      "motion. Reads sparse/0, sparse/static and turntable.json, writes s2gs/point_cloud.ply and "
      "s2gs/log.jsonl. Stopped with Ctrl-C, or killed, the same command goes on where it was, and is skipped "
      "when it is done. Only with --output_path it always runs: its result is then no part of the workspace.",
      "--workspace_path scan --image_path scan/images --test_every 10");
  AddSceneOptions(&options, a);
  AddBackendOptions(&options, &a->backend);
  AddTrainOptions(&options, &a->train);
  AddInitialiseOptions(&options, &a->train.initial);
  return options;
}

}  // namespace

void RunGaussianTrainer(CommandContext& context) {
  Arguments a;
  const Options& options = DeclareOptions(context, &a);
  Reporter& reporter = context.Parse();

  const Workspace workspace{a.workspace_path};
  StageRunner runner(workspace, reporter);
  const bool uses_workspace_masks =
      a.mask_path.empty() && (a.scene.mode == TrainMode::kMasks || a.scene.masks_as_hint);
  const TrainingScenePaths paths = {workspace.ObjectModel(),
                                    workspace.StaticModel(),
                                    workspace.Turntable(),
                                    a.image_path.empty() ? workspace.Images() : a.image_path,
                                    uses_workspace_masks ? workspace.Masks() : a.mask_path,
                                    a.truth_mask_path};
  const fs::path output = a.output_path.empty() ? workspace.Own() : a.output_path;
  const fs::path ply = output / "point_cloud.ply";
  const fs::path checkpoints = output / "checkpoints";
  TrainFiles files;
  files.checkpoint = checkpoints / "latest.checkpoint";
  files.log = output / "log.jsonl";
  files.resume = a.resume;

  const auto train = [&] {
    CreateFolder(checkpoints);
    RemoveStaleTemporaries(output);
    RemoveStaleTemporaries(checkpoints);
    const std::unique_ptr<Backend> backend = MakeBackend(a.backend, reporter);
    ApplyPreset(options, backend->Info().kind, &a);
    TrainOptions fitted = a.train;
    const TrainingScene scene = ReadTrainingScene(paths, a.scene, reporter, [&](const TrainingSize& size) {
      FitTrainingMemory(size, backend->Info().kind, LimitsOf(a, backend->Info()), &fitted, reporter);
    });
    // As asked for: how much memory is free is no reason to begin anew.
    files.settings = SettingsOf(options, scene);
    const TrainResult result = Train(scene, fitted, options.random_seed(), files, backend.get(), reporter);
    WriteGaussianPly(ply, ForFile(result.gaussians, scene), {a.ply_layout, a.foreground_only});
    PrintSummary(result, scene, ply, context.out());
  };
  if (a.output_path.empty()) {
    Stage stage = {"gaussian_trainer",
                   {paths.object_model, paths.static_model, paths.turntable, paths.images},
                   StageOptions(options),
                   {ply, files.log},
                   {"turntable_mapper"}};
    for (const fs::path& path : {paths.masks, paths.truth_masks, a.scene.test_list}) {
      if (!path.empty()) stage.inputs.push_back(path);
    }
    if (!runner.Run(stage, train)) context.out() << "up to date            " << ply.string() << '\n';
  } else {
    train();
  }
  // Not before the model counts as done: killed in between, training would start anew.
  std::error_code ec;
  fs::remove(files.checkpoint, ec);
}

}  // namespace s2gs
