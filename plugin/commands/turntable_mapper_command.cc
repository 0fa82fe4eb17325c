#include "plugin/commands/turntable_mapper_command.h"

#include <glog/logging.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "plugin/colmap/body_mapper.h"
#include "plugin/colmap/colmap_process.h"
#include "plugin/colmap/point_colors.h"
#include "plugin/commands/turntable_report.h"
#include "plugin/stage/scan_input.h"
#include "plugin/stage/stage.h"
#include "plugin/stage/workspace.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/relocalise/guided_registration.h"
#include "sfm_split/relocalise/scan_candidate.h"
#include "sfm_split/relocalise/scan_refinement.h"
#include "sfm_split/scene/io/colmap_database.h"
#include "sfm_split/scene/io/top_view.h"
#include "sfm_split/scene/io/turntable_file.h"
#include "sfm_split/turntable/align_scene.h"
#include "sfm_split/turntable/single_axis_scene.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr uint64_t kMaxReportBytes = uint64_t{1} << 28;
// Free SfM that places fewer of the images does not stand without the single-axis path beside it.
constexpr double kEnoughImages = 0.95;

// Photos that are placed later leave the errors of the object's points as they were, if they are right.
constexpr double kMaxNoiseGrowth = 1.5;
constexpr double kLeastNoisePx = 0.3;

enum class MappingPath { kAuto, kFreeSfm, kSingleAxis };

struct Settings {
  fs::path workspace_path;
  fs::path image_path;
  fs::path colmap_path;
  MappingPath path = MappingPath::kAuto;
  int max_attempts = 3;
  std::vector<std::string> mapper_options;
  TurntableOptions turntable;
  JointOptions joint;
  RefineOptions refine;
  SingleAxisOptions single_axis;
  GuidedOptions guided;
};

void AddOptions(Options& options, Settings* settings) {
  options.Add("workspace_path", &settings->workspace_path, "the workspace, with split/ from motion_splitter")
      .Required();
  options.Add("image_path", &settings->image_path, "the photos; empty: images in the workspace");
  options.Add("colmap_path", &settings->colmap_path,
              "the colmap executable or its folder; empty: searched for on PATH");
  options.AddEnum(
      "path", &settings->path,
      {{"auto", MappingPath::kAuto},
       {"free_sfm", MappingPath::kFreeSfm},
       {"single_axis", MappingPath::kSingleAxis}},
      "how the object is placed: by free SfM, by the table's axis and angles alone, or by whichever "
      "places more");
  options.Add("max_mapper_attempts", &settings->max_attempts,
              "runs of `colmap mapper` for one body, each more tolerant");
  options.Add("mapper_options", &settings->mapper_options,
              "options for `colmap mapper` in its own spelling, like Mapper.ba_global_max_refinements=2");
  auto turntable = options.Group("Turntable", &settings->turntable);
  turntable.Add("inlier_sigmas", &TurntableOptions::inlier_sigmas, "images beyond are left out and mended");
  turntable
      .Add("max_axis_sigma_deg", &TurntableOptions::max_axis_sigma_deg,
           "an axis known less well: the steps are too small")
      .Unit("degrees");
  turntable.Add("max_scale_sigma_rel", &TurntableOptions::max_scale_sigma_rel,
                "a scale known less well counts as unobservable");
  auto joint = options.Group("Joint", &settings->joint);
  joint.AddEnum("model", &JointOptions::model,
                {{"auto", JointModel::kAuto},
                 {"shared_stations", JointModel::kSharedStations},
                 {"free_cameras", JointModel::kFreeCameras},
                 {"free_object", JointModel::kFreeObject}},
                "what the poses share");
  joint.Add("refine_focal_length", &JointOptions::refine_focal_length, "adjust the focal lengths");
  joint.Add("refine_principal_point", &JointOptions::refine_principal_point, "adjust the principal points");
  joint.Add("refine_extra_params", &JointOptions::refine_extra_params, "adjust the distortion");
  joint.AddEnum(
      "loss", &JointOptions::loss,
      {{"squared", JointLoss::kSquared}, {"huber", JointLoss::kHuber}, {"cauchy", JointLoss::kCauchy}},
      "of the reprojection errors");
  joint
      .Add("loss_scale_px", &JointOptions::loss_scale_px,
           "where the loss turns from squared; 0: at twice the keypoints' standard deviation")
      .Unit("px");
  joint
      .Add("max_reprojection_error_px", &JointOptions::max_reprojection_error_px,
           "observations beyond are taken out")
      .Unit("px");
  joint
      .Add("min_triangulation_deg", &JointOptions::min_triangulation_deg,
           "points whose rays all meet at less are taken out")
      .Unit("degrees");
  joint.Add("max_rounds", &JointOptions::max_rounds, "of adjusting and taking out");
  joint.Add("max_iterations", &JointOptions::max_iterations, "of Levenberg-Marquardt in a round");
  joint.Add("function_tolerance", &JointOptions::function_tolerance, "relative decrease at which it stops");
  joint.Add("compute_covariance", &JointOptions::compute_covariance, "report standard deviations");
  joint.Add(
      "num_threads", &JointOptions::num_threads,
      "0: all cores; with several, sums are taken in another order each time, and results differ in their "
      "last digits");
  auto refine = options.Group("Refine", &settings->refine);
  refine.Add("max_rounds", &RefineOptions::max_rounds, "of triangulating, mending, adjusting and labelling");
  refine.Add("max_error_px", &RefineOptions::max_error_px, "reprojection error of a point's keypoints")
      .Unit("px");
  refine
      .Add("min_triangulation_deg", &RefineOptions::min_triangulation_deg,
           "points whose rays all meet at less are left out")
      .Unit("degrees");
  refine.Add("min_mend_inliers", &RefineOptions::min_mend_inliers,
             "keypoints that must agree before an image is taken back");
  refine.Add("min_mend_share", &RefineOptions::min_mend_share, "their share of those that could");
  refine.Add("max_adjusted_observations", &RefineOptions::max_adjusted_observations,
             "of the object in the adjustment");
  refine.Add("max_adjusted_background", &RefineOptions::max_adjusted_background,
             "background points in the adjustment");
  auto axis = options.Group("SingleAxis", &settings->single_axis);
  axis.Add("noise_px", &SingleAxisOptions::noise_px, "expected standard deviation of a keypoint").Unit("px");
  axis.Add("min_matches", &SingleAxisOptions::min_matches, "pairs with fewer are not used");
  axis.Add("num_directions", &SingleAxisOptions::num_directions, "of the axis in the coarse search");
  axis.Add("num_refined", &SingleAxisOptions::num_refined, "axes of the coarse search that are refined");
  axis.Add("max_matches", &SingleAxisOptions::max_matches, "of a pair in the adjustment");
  axis.Add("min_inlier_ratio", &SingleAxisOptions::min_inlier_ratio,
           "of all matches, below which nothing was found");
  auto guided = options.Group("Guided", &settings->guided);
  guided.Add("max_looks", &GuidedOptions::max_looks, "keypoints whose descriptors stand for a point");
  guided.Add("num_candidates", &GuidedOptions::num_candidates, "points that a keypoint proposes");
  guided.Add("max_distance_rad", &GuidedOptions::max_distance_rad, "between descriptors").Unit("radians");
  guided
      .Add("max_view_change_deg", &GuidedOptions::max_view_change_deg,
           "between the directions a point is seen from in two photos")
      .Unit("degrees");
  guided.Add("max_error_px", &GuidedOptions::max_error_px, "of a proposal").Unit("px");
  guided
      .Add("window_px", &GuidedOptions::window_px,
           "around a point's place, in which its keypoint is looked for")
      .Unit("px");
  guided.Add("min_inliers", &GuidedOptions::min_inliers,
             "proposals that must agree on a photo's table angle");
  guided.Add("min_margin", &GuidedOptions::min_margin, "how many times those at any other angle");
  guided.Add("max_chance", &GuidedOptions::max_chance,
             "expected number of angles at which as many agree by chance");
}

class Stopwatch {
 public:
  double Lap() {
    const auto now = std::chrono::steady_clock::now();
    const double seconds = std::chrono::duration<double>(now - start_).count();
    start_ = now;
    return seconds;
  }

 private:
  std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
};

json ReadJson(const fs::path& path) {
  try {
    return json::parse(ReadWholeFile(path, kMaxReportBytes, "Delete it and run turntable_mapper again"));
  } catch (const json::exception& error) {
    throw UserError(path, std::string("is damaged: ") + error.what(),
                    "Delete it and run turntable_mapper again");
  }
}

void WriteJson(const fs::path& path, const json& content) {
  WriteFileAtomically(path, [&](std::ostream& stream) { stream << content.dump(1) << '\n'; });
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

size_t CountImages(const std::vector<ImagePairMatches>& pairs) {
  std::set<int> images;
  for (const ImagePairMatches& pair : pairs) {
    images.insert(pair.image1);
    images.insert(pair.image2);
  }
  return images.size();
}

class TurntableMapper {
 public:
  TurntableMapper(const Settings& settings, const Workspace& workspace, Reporter& reporter)
      : settings_(settings),
        workspace_(workspace),
        reporter_(reporter),
        split_(workspace.ObjectDatabase().parent_path()) {}

  fs::path ObjectFolder() const { return split_ / "object_model"; }
  fs::path BackgroundFolder() const { return split_ / "static_model"; }
  fs::path ReportPath() const { return split_ / "turntable_mapper.json"; }

  void ReadInput() { input_ = ReadScanInput(workspace_); }
  const ScanInput& input() const { return input_; }
  bool HasBackground() const {
    return input_.capture_case == CaptureCase::kTurntable && CountImages(input_.features.static_pairs) >= 2;
  }

  void Map(bool of_object, ColmapProgram* colmap);
  void Place();

 private:
  ScanCandidate ByFreeSfm(const ColmapModel& object, const ColmapModel* background, const char* how);
  ScanCandidate BySingleAxis(const ColmapModel* background);
  void PlaceMissing(ScanCandidate* candidate, json* report);
  bool IsEnough(const ScanCandidate& candidate) const {
    return candidate.is_usable && static_cast<double>(candidate.aligned.scene.views.size()) >=
                                      kEnoughImages * static_cast<double>(input_.features.images.size());
  }
  void WriteScene(ScanCandidate* candidate, json report);
  void WriteOneBody(const std::vector<ColmapModel>& models, json report);

  const Settings& settings_;
  Workspace workspace_;
  Reporter& reporter_;
  fs::path split_;
  ScanInput input_;
  json seconds_ = json::object();
};

void TurntableMapper::Map(bool of_object, ColmapProgram* colmap) {
  BodyMapping mapping;
  mapping.body = of_object ? "the object" : "the background";
  mapping.database = of_object ? workspace_.ObjectDatabase() : workspace_.StaticDatabase();
  mapping.images = settings_.image_path;
  mapping.output = of_object ? ObjectFolder() : BackgroundFolder();
  mapping.min_model_size = of_object ? 3 : 2;
  mapping.num_images =
      static_cast<int>(CountImages(of_object ? input_.features.object_pairs : input_.features.static_pairs));
  mapping.enough_share = of_object ? 0.5 : 0.9;
  mapping.max_attempts = settings_.max_attempts;
  mapping.options = settings_.mapper_options;
  reporter_.Info("mapping " + mapping.body + " with colmap " + colmap->version());
  WriteJson(mapping.output / "attempts.json", ToJson(MapBody(mapping, colmap, reporter_)));
}

ScanCandidate TurntableMapper::ByFreeSfm(const ColmapModel& object, const ColmapModel* background,
                                         const char* how) {
  ScanCandidate candidate;
  std::map<std::string, int> station_of_image;
  for (const ScanImage& image : input_.features.images) station_of_image[image.name] = image.station;
  AlignOptions options;
  options.turntable = settings_.turntable;
  candidate.aligned = AlignScene(object, background, station_of_image, options);
  const TurntableSolution& solution = candidate.aligned.solution;
  if (candidate.aligned.scene.views.empty()) {
    candidate.finding =
        std::string(how) + " makes no turntable (" + TurntableMotionName(solution.motion) + ")";
    return candidate;
  }
  const size_t aligned_images = candidate.aligned.scene.views.size();
  candidate.refined =
      RefineScan(input_.features, &object, settings_.joint, settings_.refine, reporter_, &candidate.aligned);
  candidate.is_usable = true;
  candidate.finding = std::string(how) + " placed " + std::to_string(object.images.size()) + " images, " +
                      std::to_string(aligned_images) + " on one turntable, " +
                      std::to_string(candidate.aligned.scene.views.size()) + " after mending";
  return candidate;
}

ScanCandidate TurntableMapper::BySingleAxis(const ColmapModel* background) {
  ScanCandidate candidate;
  SingleAxisSolution solution;
  SingleAxisOptions options = settings_.single_axis;
  candidate.aligned = SceneFromSingleAxis(input_.features, background, options, reporter_, &solution);
  if (!solution.found) {
    candidate.finding = "the single axis was not found (" + solution.reason + ")";
    return candidate;
  }
  const size_t found = candidate.aligned.scene.views.size();
  candidate.refined =
      RefineScan(input_.features, nullptr, settings_.joint, settings_.refine, reporter_, &candidate.aligned);
  candidate.is_usable = true;
  candidate.finding = "the single axis placed " + std::to_string(found) + " images, " +
                      std::to_string(candidate.aligned.scene.views.size()) + " after mending";
  return candidate;
}

// Photos that are still missing, by what the object's points look like.
void TurntableMapper::PlaceMissing(ScanCandidate* candidate, json* report) {
  (*report)["guided"] = json::array();
  if (candidate->aligned.scene.views.size() >= input_.features.images.size()) return;
  const ColmapDatabase database =
      ColmapDatabase::Open(workspace_.ObjectDatabase(), ColmapDatabase::Access::kReadOnly);
  const ReadDescriptors read = [&](int image) {
    const ScanImage& of_image = input_.features.images[static_cast<size_t>(image)];
    const DescriptorMatrix descriptors = database.ReadDescriptors(of_image.image_id);
    if (static_cast<size_t>(descriptors.rows()) != of_image.keypoints.size()) {
      throw UserError(workspace_.ObjectDatabase(),
                      "image " + of_image.name + " has other than one descriptor a keypoint",
                      "Run `colmap feature_extractor` again on a new database");
    }
    return std::vector<uint8_t>(descriptors.data(), descriptors.data() + descriptors.size());
  };
  while (candidate->aligned.scene.views.size() < input_.features.images.size()) {
    const size_t before = candidate->aligned.scene.views.size();
    AlignedScene aligned = candidate->aligned;
    std::vector<ImagePairMatches> pairs = input_.features.object_pairs;
    const std::vector<GuidedPhoto> placed =
        RegisterByAppearance(input_.features, read, settings_.guided, reporter_, &aligned, &pairs);
    if (placed.empty()) return;
    reporter_.Info(std::to_string(placed.size()) + " of " +
                   std::to_string(input_.features.images.size() - before) +
                   " missing photos placed by what the object's points look like");
    std::swap(input_.features.object_pairs, pairs);
    aligned.object.points3D.clear();
    RefineReport refined =
        RefineScan(input_.features, nullptr, settings_.joint, settings_.refine, reporter_, &aligned);
    const double noise = candidate->refined.joint.object_rms_px;
    if (aligned.scene.views.size() <= before ||
        refined.joint.object_rms_px > kMaxNoiseGrowth * std::max(noise, kLeastNoisePx)) {
      reporter_.Info("which the adjustment does not bear out: they are left out again");
      std::swap(input_.features.object_pairs, pairs);
      return;
    }
    refined.mended.insert(refined.mended.begin(), candidate->refined.mended.begin(),
                          candidate->refined.mended.end());
    candidate->aligned = std::move(aligned);
    candidate->refined = std::move(refined);
    for (const GuidedPhoto& photo : placed) {
      (*report)["guided"].push_back({{"image", photo.name},
                                     {"inliers", photo.inliers},
                                     {"elsewhere", photo.other},
                                     {"chance", photo.chance},
                                     {"matches", photo.matches}});
    }
  }
}

void TurntableMapper::WriteScene(ScanCandidate* candidate, json report) {
  Stopwatch watch;
  AlignedScene& aligned = candidate->aligned;
  ColorPoints(settings_.image_path, {&aligned.object, &aligned.background}, reporter_);
  WriteColmapModel(workspace_.ObjectModel(), aligned.object, ColmapFormat::kBinary);
  std::error_code ec;
  if (!aligned.background.images.empty()) {
    WriteColmapModel(workspace_.StaticModel(), aligned.background, ColmapFormat::kBinary);
  } else {
    fs::remove_all(workspace_.StaticModel(), ec);
  }
  WriteTurntableFile(workspace_.Turntable(), ToTurntableFile(aligned.scene));
  WriteTopView(workspace_.TopView(), aligned.scene, aligned.object, aligned.background);
  WriteScanLabels(workspace_, input_.features.images, candidate->refined.labels);
  report.update(DescribeScene(aligned, candidate->refined));
  seconds_["write"] = watch.Lap();
  report["seconds"] = seconds_;
  WriteJson(ReportPath(), report);
}

// All photos show one rigid body: SfM's own model, which nothing moves in.
void TurntableMapper::WriteOneBody(const std::vector<ColmapModel>& models, json report) {
  if (models.empty()) {
    throw UserError(workspace_.ObjectDatabase(), "colmap mapper found no model",
                    "Look at its output with --log_level debug; more photos with smaller steps may help");
  }
  ColmapModel model = models[0];
  ColorPoints(settings_.image_path, {&model}, reporter_);
  WriteColmapModel(workspace_.ObjectModel(), model, ColmapFormat::kBinary);
  std::error_code ec;
  fs::remove_all(workspace_.StaticModel(), ec);
  TurntableFile file;
  std::vector<std::string> names;
  names.reserve(model.images.size());
  for (const auto& [id, image] : model.images) names.push_back(image.name);
  std::sort(names.begin(), names.end());
  for (const std::string& name : names) {
    file.images.push_back({name, file.num_stations, 0, Rigid3()});
    ++file.num_stations;
  }
  WriteTurntableFile(workspace_.Turntable(), file);
  report["registered"] = names.size();
  report["missing"] = json::array();
  for (const ScanImage& image : input_.features.images) {
    if (!std::binary_search(names.begin(), names.end(), image.name)) report["missing"].push_back(image.name);
  }
  report["object"] = DescribePoints(model);
  report["seconds"] = seconds_;
  WriteJson(ReportPath(), report);
}

void TurntableMapper::Place() {
  Stopwatch watch;
  json report = {{"version", 1},
                 {"case", CaptureCaseName(input_.capture_case)},
                 {"reason", input_.reason},
                 {"images", input_.features.images.size()}};
  std::error_code ec;
  for (const auto& [body, folder] :
       {std::make_pair("object", ObjectFolder()), std::make_pair("background", BackgroundFolder())}) {
    if (!fs::exists(folder / "attempts.json", ec)) continue;
    report["mapping"][body] = ReadJson(folder / "attempts.json");
    double sum = 0;
    for (const json& attempt : report["mapping"][body]) sum += attempt.at("seconds").get<double>();
    seconds_[std::string("map_") + body] = sum;
  }
  std::vector<ColmapModel> objects = ReadMappedModels(ObjectFolder(), reporter_);
  if (input_.capture_case == CaptureCase::kOneBody) {
    report["path"] = "one body";
    report["path_reason"] = input_.reason.empty() ? "the split found nothing to take apart" : input_.reason;
    WriteOneBody(objects, report);
    return;
  }
  std::vector<ColmapModel> backgrounds;
  if (HasBackground()) backgrounds = ReadMappedModels(BackgroundFolder(), reporter_);
  const ColmapModel* background = backgrounds.empty() ? nullptr : backgrounds.data();
  if (HasBackground() && background == nullptr) {
    reporter_.Warn("the background could not be mapped: stations are placed by the object alone");
  }
  seconds_["read"] = watch.Lap();

  ScanCandidate best;
  std::string findings;
  const auto consider = [&](ScanCandidate candidate, const char* name) {
    findings += (findings.empty() ? "" : "; ") + candidate.finding;
    seconds_[name] = watch.Lap();
    if (!candidate.IsBetterThan(best)) return;
    best = std::move(candidate);
    report["path"] = name;
  };
  TurntableMotion motion = TurntableMotion::kTooFewImages;
  if (settings_.path != MappingPath::kSingleAxis) {
    if (objects.empty()) {
      findings = "free SfM found no model of the object";
    } else {
      ColmapModel object = objects[0];
      const int joined = JoinPartialModels({objects.begin() + 1, objects.end()}, &object);
      if (joined > 0) {
        reporter_.Info(std::to_string(joined) + " images joined from partial models of the object");
      }
      ScanCandidate candidate = ByFreeSfm(object, background, "free SfM");
      motion = candidate.aligned.solution.motion;
      consider(std::move(candidate), "free_sfm");
      if (background != nullptr && !IsEnough(best)) {
        // The background's reconstruction may be what is wrong.
        consider(ByFreeSfm(object, nullptr, "free SfM of the object alone"), "free_sfm_object");
      }
    }
  }
  if (settings_.path == MappingPath::kSingleAxis ||
      (settings_.path == MappingPath::kAuto && !IsEnough(best))) {
    consider(BySingleAxis(background), "single_axis");
  }
  report["path_reason"] = findings;
  if (best.is_usable) {
    PlaceMissing(&best, &report);
    seconds_["place_missing"] = watch.Lap();
    WriteScene(&best, report);
    return;
  }
  if (motion == TurntableMotion::kNothingRotates) {
    reporter_.Warn("nothing rotates: the photos are taken as those of one body");
    report["path"] = "one body";
    WriteOneBody(objects, report);
    return;
  }
  throw UserError(
      workspace_.ObjectDatabase(), "the photos do not make a turntable: " + findings,
      "Look at the models in split/ with `colmap gui`; more photos with smaller steps, or a speckled "
      "sheet on the table, help");
}

}  // namespace

void RunTurntableMapper(CommandContext& context) {
  Settings settings;
  Options& options = context.Declare(
      "Runs `colmap mapper` on both databases of motion_splitter, finds the table's axis, angles and the "
      "scale "
      "between the two models, takes back the photos that were left out, adjusts everything together, and "
      "writes "
      "it in one frame: sparse/0 (the object held still), sparse/static (the background) and turntable.json.",
      "--workspace_path scan --image_path scan/images");
  AddOptions(options, &settings);
  Reporter& reporter = context.Parse();
  FLAGS_minloglevel = google::GLOG_FATAL;  // Ceres reports each step that it takes back
  const auto seed = static_cast<uint32_t>(options.random_seed());
  settings.turntable.random_seed = seed;
  settings.single_axis.random_seed = seed;

  const Workspace workspace{settings.workspace_path};
  StageRunner runner(workspace, reporter);
  if (settings.image_path.empty()) settings.image_path = workspace.Images();
  TurntableMapper mapper(settings, workspace, reporter);
  mapper.ReadInput();
  if (!mapper.input().reason.empty()) {
    reporter.Info(std::string("the split found: ") + CaptureCaseName(mapper.input().capture_case) + " (" +
                  mapper.input().reason + ")");
  }

  std::optional<ColmapProgram> colmap;
  const auto map = [&](bool of_object) {
    std::error_code ec;
    if (!fs::is_directory(settings.image_path, ec)) {
      throw UserError(settings.image_path, "no such folder of photos, which colmap mapper needs",
                      "Check --image_path");
    }
    if (!colmap) colmap = ColmapProgram::Find(settings.colmap_path, reporter);
    mapper.Map(of_object, &*colmap);
  };
  std::map<std::string, std::string> mapping_options;
  for (const auto& [name, value] : options.Values()) {
    if (name == "mapper_options" || name == "max_mapper_attempts") mapping_options[name] = value;
  }
  std::vector<std::string> before = {"motion_splitter"};
  if (settings.path != MappingPath::kSingleAxis || mapper.input().capture_case == CaptureCase::kOneBody) {
    runner.Run({"object_mapper",
                {workspace.ObjectDatabase()},
                mapping_options,
                {mapper.ObjectFolder()},
                {"motion_splitter"}},
               [&] { map(true); });
    before.emplace_back("object_mapper");
  }
  if (mapper.HasBackground()) {
    runner.Run({"background_mapper",
                {workspace.StaticDatabase()},
                mapping_options,
                {mapper.BackgroundFolder()},
                {"motion_splitter"}},
               [&] { map(false); });
    before.emplace_back("background_mapper");
  }
  runner.Run({"turntable_mapper",
              {workspace.ObjectDatabase(), workspace.StaticDatabase()},
              options.Values(),
              {workspace.ObjectModel(), workspace.Turntable(), mapper.ReportPath()},
              before},
             [&] { mapper.Place(); });
  PrintTurntableSummary(ReadJson(mapper.ReportPath()), context.out());
}

}  // namespace s2gs
