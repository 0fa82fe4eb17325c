#include "plugin/commands/turntable_mapper_command.h"

#include <fmt/format.h>
#include <glog/logging.h>

#include <algorithm>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "plugin/colmap/attempt_beside.h"
#include "plugin/colmap/body_mapper.h"
#include "plugin/colmap/colmap_process.h"
#include "plugin/colmap/point_colors.h"
#include "plugin/commands/mapping_failure.h"
#include "plugin/commands/turntable_mapper_options.h"
#include "plugin/outputs/steady_photo.h"
#include "plugin/outputs/turntable_report.h"
#include "plugin/report/verdict_json.h"
#include "plugin/stage/angle_list.h"
#include "plugin/stage/scan_input.h"
#include "plugin/stage/stage.h"
#include "plugin/stage/stage_stamp.h"
#include "plugin/stage/workspace.h"
#include "s2gs/image/image_file.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/stopwatch.h"
#include "sfm_split/circular_motion/circular_search.h"
#include "sfm_split/evidence/scan_evidence.h"
#include "sfm_split/relocalise/one_camera.h"
#include "sfm_split/relocalise/place_scan.h"
#include "sfm_split/scene/io/colmap_database.h"
#include "sfm_split/scene/io/top_view.h"
#include "sfm_split/scene/io/turntable_file.h"
#include "sfm_split/turntable/steady_cameras.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

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
  TurntableMapper(const TurntableMapperSettings& settings, const Workspace& workspace, Reporter& reporter)
      : settings_(settings),
        workspace_(workspace),
        reporter_(reporter),
        split_(workspace.ObjectDatabase().parent_path()) {}

  fs::path ObjectFolder() const { return split_ / "object_model"; }
  fs::path BackgroundFolder() const { return split_ / "static_model"; }
  fs::path ReportPath() const { return split_ / "turntable_mapper.json"; }

  void ReadInput() { input_ = ReadScanInput(workspace_); }
  /// What is stated of the table's angles goes into the options of the adjustment.
  void ReadStatedAngles(TurntableMapperSettings* settings) const;
  const ScanInput& input() const { return input_; }
  bool HasBackground() const {
    return input_.capture_case == CaptureCase::kTurntable && CountImages(input_.features.static_pairs) >= 2;
  }

  /// Begins a part of PlaceByCircle() and Place() that needs no model, while COLMAP's mapper makes the
  /// object's on one thread. They find it in the options.
  void BeginCircularSearch(TurntableMapperSettings* settings);
  void Map(bool of_object, ColmapProgram* colmap, Reporter& reporter) const;
  /// Whether circular motion is asked whether it does without the object's model.
  bool TriesCircleFirst() const {
    return settings_.circle_first && settings_.placement.path == PlacementPath::kAuto &&
           input_.capture_case != CaptureCase::kOneBody;
  }
  /// Whether it does. Place() writes what it came to; otherwise it says why not. May be called from another
  /// thread than the one that made this.
  bool PlaceByCircle(Reporter& reporter);
  void Place();

 private:
  // Photos as cameras that stand still would have taken them, and what was found of them.
  struct Steadied {
    SteadyCameras cameras;
    std::optional<ScanFeatures> features;  // none: no camera moved
  };
  Steadied Steady(const std::map<uint32_t, Camera>& cameras) const {
    Steadied steadied{SteadyCameras(input_.features, cameras), std::nullopt};
    if (steadied.cameras.AnyMoved()) steadied.features = steadied.cameras.Steady(input_.features);
    return steadied;
  }
  const ScanFeatures& FeaturesOf(const Steadied& steadied) const {
    return steadied.features ? *steadied.features : input_.features;
  }
  ReadGreyPhoto PhotosOf(const SteadyCameras& cameras) const;
  void SayTurn(const Steadied& steadied, json* report) const;
  void WritePlaced(const Steadied& steadied, ScanPlacement* placement, json report);
  std::vector<uint8_t> ReadDescriptorsOf(const ColmapDatabase& database, int image) const;
  GreyPhoto ReadPhoto(const std::string& name) const;
  // \param evidence  of the candidate, where it was gathered before.
  void WriteScene(const ScanFeatures& steady, const SteadyCameras& cameras, ScanCandidate* candidate,
                  std::optional<ScanEvidence> evidence, json report);
  ScanVerdict RecordFailure(json report);
  [[noreturn]] void Fail(json report, const std::string& problem);
  void WriteOneBody(const std::vector<ColmapModel>& models, json report);
  void Describe(const ScanPlacement& placement, json* report);
  bool PlaceBeforeCamera(const std::vector<ColmapModel>& objects, const ReadDescriptors& read_descriptors,
                         json report);

  const TurntableMapperSettings& settings_;
  Workspace workspace_;
  Reporter& reporter_;
  fs::path split_;
  ScanInput input_;
  json seconds_ = json::object();
  std::optional<std::pair<Steadied, ScanPlacement>> by_circle_;
  std::string not_by_circle_;  // why circular motion did not do; empty: it was not asked, or it did
  std::optional<CircularSearch> circular_search_;  // after what it searches, so that it ends first
};

void TurntableMapper::ReadStatedAngles(TurntableMapperSettings* settings) const {
  std::map<std::string, double>& stated = settings->placement.refine.stated_angles_deg;
  if (settings->step_deg != 0) {
    std::map<int, int> num_of_station;
    for (const ScanImage& image : input_.features.images) {
      stated[image.name] = settings->step_deg * num_of_station[image.station]++;
    }
  }
  if (settings->angles_path.empty()) return;
  std::vector<std::string> names;
  for (const ScanImage& image : input_.features.images) names.push_back(image.name);
  std::vector<std::string> unknown;
  stated = AnglesOfPhotos(ReadAngleList(settings->angles_path), names, settings->angles_path, &unknown);
  if (unknown.empty()) return;
  reporter_.Warn(settings->angles_path.string() + ": " + std::to_string(unknown.size()) +
                 " names are none of the photos': " + unknown[0] + ", for example");
}

void TurntableMapper::BeginCircularSearch(TurntableMapperSettings* settings) {
  // Where the tripod moved, Place() searches the features of a camera that stood still, which the model tells
  // of.
  const bool is_searched = settings->placement.path == PlacementPath::kAuto &&
                           input_.capture_case != CaptureCase::kOneBody &&
                           !SteadyCameras(input_.features, {}).AnyMoved();
  if (!is_searched) return;
  circular_search_.emplace(input_.features, settings->placement.circular, reporter_);
  settings->placement.circular.begun = &*circular_search_;
}

void TurntableMapper::Map(bool of_object, ColmapProgram* colmap, Reporter& reporter) const {
  BodyMapping mapping = of_object ? ObjectMapping() : BackgroundMapping();
  mapping.database = of_object ? workspace_.ObjectDatabase() : workspace_.StaticDatabase();
  mapping.images = settings_.image_path;
  mapping.output = of_object ? ObjectFolder() : BackgroundFolder();
  mapping.num_images =
      static_cast<int>(CountImages(of_object ? input_.features.object_pairs : input_.features.static_pairs));
  mapping.max_attempts = settings_.max_attempts;
  mapping.options = settings_.mapper_options;
  reporter.Info("mapping " + mapping.body + " with colmap " + colmap->version());
  WriteJson(mapping.output / "attempts.json", ToJson(MapBody(mapping, colmap, reporter)));
}

ReadGreyPhoto TurntableMapper::PhotosOf(const SteadyCameras& cameras) const {
  if (!settings_.adjust_to_photos) return {};
  return [this, &cameras](const std::string& name) { return SteadyPhoto(ReadPhoto(name), name, cameras); };
}

bool TurntableMapper::PlaceByCircle(Reporter& reporter) {
  CircularFinding finding;
  const Steadied searched = Steady({});
  const AlignedScene circle =
      SceneFromCircularMotion(FeaturesOf(searched), settings_.placement.circular, reporter, &finding);
  std::map<uint32_t, Camera> cameras;
  for (const Camera& camera : circle.scene.cameras) cameras.emplace(camera.camera_id, camera);
  by_circle_.emplace(Steady(cameras), ScanPlacement());
  auto& [steadied, placement] = *by_circle_;
  std::vector<ColmapModel> backgrounds;
  if (HasBackground()) backgrounds = ReadMappedModels(BackgroundFolder(), reporter);
  if (steadied.features) {
    for (ColmapModel& model : backgrounds) model = steadied.cameras.Steady(model);
  }
  placement = PlaceByCircleAlone(FeaturesOf(steadied), circle, finding,
                                 backgrounds.empty() ? nullptr : backgrounds.data(),
                                 PhotosOf(steadied.cameras), settings_.placement, reporter);
  if (placement.outcome == PlacementOutcome::kPlaced) return true;
  not_by_circle_ = placement.findings;
  by_circle_.reset();
  reporter.Info("circular motion does not do by itself: " + not_by_circle_);
  return false;
}

std::vector<uint8_t> TurntableMapper::ReadDescriptorsOf(const ColmapDatabase& database, int image) const {
  const ScanImage& of_image = input_.features.images[static_cast<size_t>(image)];
  const DescriptorMatrix descriptors = database.ReadDescriptors(of_image.image_id);
  if (static_cast<size_t>(descriptors.rows()) != of_image.keypoints.size()) {
    throw UserError(workspace_.ObjectDatabase(),
                    "image " + of_image.name + " has other than one descriptor a keypoint",
                    "Run `colmap feature_extractor` again on a new database");
  }
  return {descriptors.data(), descriptors.data() + descriptors.size()};
}

// An empty one where it cannot be read or is not the one that its features come from.
GreyPhoto TurntableMapper::ReadPhoto(const std::string& name) const {
  const auto of_name = [&](const ScanImage& image) { return image.name == name; };
  const auto image = std::find_if(input_.features.images.begin(), input_.features.images.end(), of_name);
  const Camera& camera = input_.features.cameras.at(image->camera_id);
  try {
    Image8 photo = ReadImage(settings_.image_path / name, 1);
    if (static_cast<uint64_t>(photo.width) != camera.width ||
        static_cast<uint64_t>(photo.height) != camera.height) {
      return {};
    }
    return {photo.width, photo.height, std::move(photo.pixels)};
  } catch (const UserError&) {
    return {};  // ColorPoints warns
  }
}

void TurntableMapper::WriteScene(const ScanFeatures& steady, const SteadyCameras& cameras,
                                 ScanCandidate* candidate, std::optional<ScanEvidence> evidence,
                                 json report) {
  Stopwatch watch;
  AlignedScene& aligned = candidate->aligned;
  const RefineReport& refined = candidate->refined;
  report.update(DescribeScene(aligned, refined));
  if (!evidence) {
    evidence = GatherEvidence(steady, aligned, refined.joint, refined.held_back, candidate->matches,
                              settings_.placement.refine.max_error_px);
  }
  cameras.Shake(&aligned);
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
  for (const std::string& said : refined.angle_contradictions) reporter_.Warn(said);
  for (const KnownAngles& angles : refined.known_angles) {
    if (!angles.is_believed) continue;
    reporter_.Info(fmt::format("station {}: {} stated angles hold to {:.3f} degrees", angles.station,
                               angles.prior.places.size(), angles.scatter_rad / kDegree));
  }
  report["verdict"] = ToJson(JudgeScan(*evidence), *evidence);
  seconds_["write"] = watch.Lap();
  report["seconds"] = seconds_;
  WriteJson(ReportPath(), report);
}

// Leaves a report with the verdict where nothing has a place.
ScanVerdict TurntableMapper::RecordFailure(json report) {
  ScanEvidence evidence = GatherOneBodyEvidence(input_.features, {}, 0);
  evidence.is_one_body = input_.capture_case == CaptureCase::kOneBody;
  ScanVerdict verdict = JudgeScan(evidence);
  report["registered"] = 0;
  report["verdict"] = ToJson(verdict, evidence);
  report["seconds"] = seconds_;
  WriteJson(ReportPath(), report);
  return verdict;
}

// The same, and says what to photograph differently.
void TurntableMapper::Fail(json report, const std::string& problem) {
  const ScanVerdict verdict = RecordFailure(std::move(report));
  std::string remedy = "Look at the models in split/ with `colmap gui`. What helps: ";
  for (size_t k = 0; k < verdict.advice.size(); ++k) remedy += (k > 0 ? "; " : "") + verdict.advice[k];
  throw UserError(workspace_.ObjectDatabase(), problem, remedy);
}

// All photos show one rigid body: SfM's own model, which nothing moves in.
void TurntableMapper::WriteOneBody(const std::vector<ColmapModel>& models, json report) {
  if (models.empty()) {
    RecordFailure(std::move(report));
    throw ExplainNoModel(workspace_.ObjectDatabase(), input_.features);
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
  std::vector<Camera> cameras;
  for (const auto& [id, camera] : model.cameras) cameras.push_back(camera);
  const ScanEvidence evidence =
      GatherOneBodyEvidence(input_.features, cameras, static_cast<int>(model.images.size()));
  report["verdict"] = ToJson(JudgeScan(evidence), evidence);
  report["seconds"] = seconds_;
  WriteJson(ReportPath(), report);
}

// What a placement found, and how long it took.
void TurntableMapper::Describe(const ScanPlacement& placement, json* report) {
  for (const auto& [name, seconds] : placement.durations)
    seconds_[name] = seconds_.value(name, 0.0) + seconds;
  (*report)["path"] = placement.path;
  (*report)["path_reason"] = placement.findings;
  if (placement.outcome != PlacementOutcome::kPlaced) return;
  (*report)["guided"] = ToJson(placement.guided);
  if (settings_.adjust_to_photos) (*report)["photos"] = ToJson(placement.photos);
}

// One body that turns before a camera, where it does.
bool TurntableMapper::PlaceBeforeCamera(const std::vector<ColmapModel>& objects,
                                        const ReadDescriptors& read_descriptors, json report) {
  ReadGreyPhoto read_photo;
  if (settings_.adjust_to_photos) read_photo = [&](const std::string& name) { return ReadPhoto(name); };
  std::optional<OneCameraScan> scan = PlaceBeforeOneCamera(input_.features, objects, read_descriptors,
                                                           read_photo, settings_.placement, reporter_);
  if (!scan) return false;
  input_.features = std::move(scan->features);
  input_.capture_case = CaptureCase::kSingleStation;
  report["case"] = CaptureCaseName(input_.capture_case);
  report["reason"] = scan->finding;
  Describe(scan->placement, &report);
  const SteadyCameras cameras(input_.features, objects[0].cameras);
  WriteScene(input_.features, cameras, &scan->placement.best, std::nullopt, std::move(report));
  return true;
}

void TurntableMapper::SayTurn(const Steadied& steadied, json* report) const {
  if (!steadied.features) return;
  const double turn_deg = steadied.cameras.LargestTurn() / kDegree;
  reporter_.Info(
      fmt::format("the tripod moved: its camera turned by up to {:.3f} degrees, which the "
                  "background tells and is taken off",
                  turn_deg));
  (*report)["tripod_turn_deg"] = turn_deg;
}

void TurntableMapper::WritePlaced(const Steadied& steadied, ScanPlacement* placement, json report) {
  Describe(*placement, &report);
  WriteScene(FeaturesOf(steadied), steadied.cameras, &placement->best, placement->evidence,
             std::move(report));
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
    const std::vector<MappingAttempt> attempts = ReadMappingAttempts(folder / "attempts.json");
    double sum = 0;
    for (const MappingAttempt& attempt : attempts) sum += attempt.seconds;
    seconds_[std::string("map_") + body] = sum;
    report["mapping"][body] = ToJson(attempts);
  }
  if (TriesCircleFirst()) report["circle_alone"] = not_by_circle_;
  if (by_circle_) {
    SayTurn(by_circle_->first, &report);
    WritePlaced(by_circle_->first, &by_circle_->second, std::move(report));
    return;
  }
  std::vector<ColmapModel> objects = ReadMappedModels(ObjectFolder(), reporter_);
  std::optional<ColmapDatabase> database;
  const ReadDescriptors read_descriptors = [&](int image) {
    if (!database) {
      database.emplace(ColmapDatabase::Open(workspace_.ObjectDatabase(), ColmapDatabase::Access::kReadOnly));
    }
    return ReadDescriptorsOf(*database, image);
  };
  if (input_.capture_case == CaptureCase::kOneBody) {
    if (!PlaceBeforeCamera(objects, read_descriptors, report)) {
      report["path"] = "one body";
      report["path_reason"] = input_.reason.empty() ? "the split found nothing to take apart" : input_.reason;
      WriteOneBody(objects, report);
    }
    return;
  }
  std::vector<ColmapModel> backgrounds;
  if (HasBackground()) backgrounds = ReadMappedModels(BackgroundFolder(), reporter_);
  const ColmapModel* background = backgrounds.empty() ? nullptr : backgrounds.data();
  if (HasBackground() && background == nullptr) {
    reporter_.Warn("the background could not be mapped: stations are placed by the object alone");
  }
  seconds_["read"] = watch.Lap();

  const Steadied steadied = Steady(objects.empty() ? std::map<uint32_t, Camera>() : objects[0].cameras);
  if (steadied.features) {
    for (ColmapModel& model : objects) model = steadied.cameras.Steady(model);
    for (ColmapModel& model : backgrounds) model = steadied.cameras.Steady(model);
  }
  SayTurn(steadied, &report);
  ScanPlacement placement = PlaceScan(FeaturesOf(steadied), objects, background, read_descriptors,
                                      PhotosOf(steadied.cameras), settings_.placement, reporter_);
  if (placement.outcome == PlacementOutcome::kPlaced) {
    WritePlaced(steadied, &placement, report);
    return;
  }
  Describe(placement, &report);
  if (placement.outcome == PlacementOutcome::kNothingRotates) {
    reporter_.Warn("nothing rotates: the photos are taken as those of one body");
    report["path"] = "one body";
    WriteOneBody(objects, report);
    return;
  }
  Fail(std::move(report), "the photos do not make a turntable: " + placement.findings);
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
  StageRunner runner(workspace, reporter);
  if (settings.image_path.empty()) settings.image_path = workspace.Images();
  TurntableMapper mapper(settings, workspace, reporter);
  mapper.ReadInput();
  mapper.ReadStatedAngles(&settings);
  if (!mapper.input().reason.empty()) {
    reporter.Info(std::string("the split found: ") + CaptureCaseName(mapper.input().capture_case) + " (" +
                  mapper.input().reason + ")");
  }

  std::optional<ColmapProgram> colmap;
  const auto map = [&](bool of_object, Reporter& to) {
    std::error_code ec;
    if (!fs::is_directory(settings.image_path, ec)) {
      throw UserError(settings.image_path, "no such folder of photos, which colmap mapper needs",
                      "Check --image_path");
    }
    if (!colmap) colmap = ColmapProgram::Find(settings.colmap_path, to);
    mapper.Map(of_object, &*colmap, to);
  };
  std::map<std::string, std::string> mapping_options;
  for (const auto& [name, value] : options.Values()) {
    if (name == "mapper_options" || name == "max_mapper_attempts") mapping_options[name] = value;
  }
  const auto map_object = [&](Reporter& to) {
    runner.Run({"object_mapper",
                {workspace.ObjectDatabase()},
                mapping_options,
                {mapper.ObjectFolder()},
                {"motion_splitter"}},
               [&] {
                 if (!mapper.TriesCircleFirst()) mapper.BeginCircularSearch(&settings);
                 map(true, to);
               });
  };
  std::vector<std::string> before = {"motion_splitter"};
  const PlacementPath path = settings.placement.path;
  if (!mapper.TriesCircleFirst() && (path == PlacementPath::kAuto || path == PlacementPath::kFreeSfm ||
                                     mapper.input().capture_case == CaptureCase::kOneBody)) {
    map_object(reporter);
    before.emplace_back("object_mapper");
  }
  if (mapper.HasBackground()) {
    runner.Run({"background_mapper",
                {workspace.StaticDatabase()},
                mapping_options,
                {mapper.BackgroundFolder()},
                {"motion_splitter"}},
               [&] { map(false, reporter); });
    before.emplace_back("background_mapper");
  }
  // Whether the object has to be mapped is told by this stage's work; all that it is mapped by counts here.
  const auto place = [&] {
    if (mapper.TriesCircleFirst()) {
      mapper.BeginCircularSearch(&settings);
      AttemptBeside([&](Reporter& to) { return mapper.PlaceByCircle(to); },
                    {map_object,
                     [&] {
                       RemoveMapping(mapper.ObjectFolder());
                       RemoveStageStamp(workspace, "object_mapper");
                     }},
                    NumThreadsOf(0), reporter);
    }
    mapper.Place();
  };
  std::vector<fs::path> inputs = {workspace.ObjectDatabase(), workspace.StaticDatabase()};
  if (!settings.angles_path.empty()) inputs.push_back(settings.angles_path);
  runner.Run({"turntable_mapper",
              inputs,
              ValuesWithout(options, {"angles_path"}),
              {workspace.ObjectModel(), workspace.Turntable(), mapper.ReportPath()},
              before,
              {workspace.StaticModel(), mapper.ReportPath().parent_path()}},
             place);
  PrintTurntableSummary(mapper.ReportPath(), context.out());
}

}  // namespace s2gs
