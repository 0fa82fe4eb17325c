#include "plugin/mapping/turntable_mapper.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstddef>
#include <nlohmann/json.hpp>
#include <set>
#include <system_error>

#include "plugin/colmap/body_mapper.h"
#include "plugin/outputs/steady_photo.h"
#include "plugin/stage/angle_list.h"
#include "s2gs/image/image_file.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/stopwatch.h"
#include "sfm_split/circular_motion/circular_scene.h"
#include "sfm_split/placement/joined_stations.h"
#include "sfm_split/placement/one_camera.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

size_t CountImages(const std::vector<ImagePairMatches>& pairs) {
  std::set<int> images;
  for (const ImagePairMatches& pair : pairs) {
    images.insert(pair.image1);
    images.insert(pair.image2);
  }
  return images.size();
}

}  // namespace

bool TurntableMapper::HasBackground() const {
  return input_.capture_case == CaptureCase::kTurntable && CountImages(input_.features.static_pairs) >= 2;
}

TurntableMapper::Steadied TurntableMapper::Steady(const std::map<uint32_t, Camera>& cameras) const {
  Steadied steadied{SteadyCameras(input_.features, cameras), std::nullopt};
  if (steadied.cameras.AnyMoved()) steadied.features = steadied.cameras.Steady(input_.features);
  return steadied;
}

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
  const nlohmann::json attempts = ToJson(MapBody(mapping, colmap, reporter));
  WriteFileAtomically(mapping.output / "attempts.json",
                      [&](std::ostream& stream) { stream << attempts.dump(1) << '\n'; });
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
  steadied.Steady(&backgrounds);
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

// One body that turns before a camera, where it does.
bool TurntableMapper::PlaceBeforeCamera(const ReadDescriptors& read_descriptors,
                                        const std::vector<ColmapModel>& objects) {
  ReadGreyPhoto read_photo;
  if (settings_.adjust_to_photos) read_photo = [&](const std::string& name) { return ReadPhoto(name); };
  std::optional<OneCameraScan> scan = PlaceBeforeOneCamera(input_.features, objects, read_descriptors,
                                                           read_photo, settings_.placement, reporter_);
  if (!scan) return false;
  input_.features = std::move(scan->features);
  input_.capture_case = CaptureCase::kSingleStation;
  output_.report()["case"] = CaptureCaseName(input_.capture_case);
  output_.report()["reason"] = scan->finding;
  output_.Describe(scan->placement);
  const SteadyCameras cameras(input_.features, objects[0].cameras);
  output_.WriteScene(input_.features, cameras, &scan->placement.best, std::nullopt);
  return true;
}

void TurntableMapper::SayTurn(const Steadied& steadied) {
  if (!steadied.features) return;
  const double turn_deg = steadied.cameras.LargestTurn() / kDegree;
  reporter_.Info(
      fmt::format("the tripod moved: its camera turned by up to {:.3f} degrees, which the "
                  "background tells and is taken off",
                  turn_deg));
  output_.report()["tripod_turn_deg"] = turn_deg;
}

void TurntableMapper::WritePlaced(const Steadied& steadied, ScanPlacement* placement) {
  output_.Describe(*placement);
  output_.WriteScene(FeaturesOf(steadied), steadied.cameras, &placement->best, placement->evidence);
}

// What was there before anything was placed.
void TurntableMapper::ReportInput() {
  output_.report().update({{"version", 1},
                           {"case", CaptureCaseName(input_.capture_case)},
                           {"reason", input_.reason},
                           {"images", input_.features.images.size()}});
  std::error_code ec;
  for (const auto& [body, folder] :
       {std::make_pair("object", ObjectFolder()), std::make_pair("background", BackgroundFolder())}) {
    if (!fs::exists(folder / "attempts.json", ec)) continue;
    const std::vector<MappingAttempt> attempts = ReadMappingAttempts(folder / "attempts.json");
    double sum = 0;
    for (const MappingAttempt& attempt : attempts) sum += attempt.seconds;
    output_.AddSeconds(std::string("map_") + body, sum);
    output_.report()["mapping"][body] = ToJson(attempts);
  }
  if (TriesCircleFirst()) output_.report()["circle_alone"] = not_by_circle_;
}

void TurntableMapper::Place() {
  ReportInput();
  if (by_circle_) {
    SayTurn(by_circle_->first);
    WritePlaced(by_circle_->first, &by_circle_->second);
    return;
  }
  std::optional<ColmapDatabase> database;
  const ReadDescriptors read_descriptors = [&](int image) {
    if (!database) {
      database.emplace(ColmapDatabase::Open(workspace_.ObjectDatabase(), ColmapDatabase::Access::kReadOnly));
    }
    return ReadDescriptorsOf(*database, image);
  };
  Stopwatch watch;
  std::vector<ColmapModel> objects = ReadMappedModels(ObjectFolder(), reporter_);
  if (input_.capture_case == CaptureCase::kOneBody) {
    PlaceOneBody(read_descriptors, objects);
    return;
  }
  std::vector<ColmapModel> backgrounds;
  if (HasBackground()) backgrounds = ReadMappedModels(BackgroundFolder(), reporter_);
  if (HasBackground() && backgrounds.empty()) {
    reporter_.Warn("the background could not be mapped: stations are placed by the object alone");
  }
  output_.AddSeconds("read", watch.Lap());
  PlaceWithModels(read_descriptors, std::move(objects), std::move(backgrounds));
}

void TurntableMapper::PlaceOneBody(const ReadDescriptors& read_descriptors,
                                   const std::vector<ColmapModel>& objects) {
  if (PlaceBeforeCamera(read_descriptors, objects)) return;
  output_.report()["path"] = "one body";
  output_.report()["path_reason"] =
      input_.reason.empty() ? "the split found nothing to take apart" : input_.reason;
  output_.WriteOneBody(objects);
}

void TurntableMapper::JoinStations(const std::vector<ColmapModel>& objects,
                                   const ReadDescriptors& read_descriptors, Steadied* steadied,
                                   ScanPlacement* placement) {
  std::optional<JoinedScan> joined =
      PlaceWithStationsJoined(FeaturesOf(*steadied), placement, objects, read_descriptors,
                              PhotosOf(steadied->cameras), settings_.placement, reporter_);
  if (!joined) return;
  output_.report()["stations_joined"] = joined->finding;
  (steadied->features ? *steadied->features : input_.features) = std::move(joined->features);
  *placement = std::move(joined->placement);
}

void TurntableMapper::PlaceWithModels(const ReadDescriptors& read_descriptors,
                                      std::vector<ColmapModel> objects,
                                      std::vector<ColmapModel> backgrounds) {
  Steadied steadied = Steady(objects.empty() ? std::map<uint32_t, Camera>() : objects[0].cameras);
  steadied.Steady(&objects);
  steadied.Steady(&backgrounds);
  SayTurn(steadied);
  ScanPlacement placement =
      PlaceScan(FeaturesOf(steadied), objects, backgrounds.empty() ? nullptr : backgrounds.data(),
                read_descriptors, PhotosOf(steadied.cameras), settings_.placement, reporter_);
  if (placement.outcome == PlacementOutcome::kPlaced) {
    if (backgrounds.empty()) JoinStations(objects, read_descriptors, &steadied, &placement);
    WritePlaced(steadied, &placement);
    return;
  }
  output_.Describe(placement);
  if (placement.outcome == PlacementOutcome::kNothingRotates) {
    reporter_.Warn("nothing rotates: the photos are taken as those of one body");
    output_.report()["path"] = "one body";
    output_.WriteOneBody(objects);
    return;
  }
  output_.Fail("the photos do not make a turntable: " + placement.findings);
}

}  // namespace s2gs
