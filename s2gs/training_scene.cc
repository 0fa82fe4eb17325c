#include "s2gs/training_scene.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <atomic>
#include <cctype>
#include <cmath>
#include <map>
#include <set>
#include <sstream>
#include <string>
#include <utility>

#include "s2gs/image/image_file.h"
#include "s2gs/image/photo_folder.h"
#include "s2gs/image/photos.h"
#include "s2gs/image/undistort.h"
#include "s2gs/photo_exposure.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/format_text.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/scene/camera_model.h"
#include "sfm_split/scene/io/colmap_model.h"
#include "sfm_split/scene/io/turntable_file.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

constexpr uint64_t kMaxListBytes = uint64_t{1} << 26;
constexpr double kPoseAgreement = 1e-3;    // of the two models' poses, in radians and scene sizes.
constexpr double kRegionQuantile = 0.995;  // of the rotating points: the few beyond are outliers.
constexpr double kRegionMargin = 1.15;     // SfM points end before the surface does.
constexpr double kRegionSlack = 0.25;  // of the radius: the plain side of a disc whose top alone has points.
constexpr int64_t kMostLoadingBytes = 2'000'000'000;  // of photos that are read at the same time
constexpr int64_t kLoadingBytesPerPixel =
    2 * (3 + 1);                            // of a photo and its mask, as they are and undistorted
constexpr size_t kRaysThatBearOut = 3;      // a point
constexpr size_t kMinPointsForRegion = 20;  // fewer say nothing about where it ends.

// What the workspace's files say before any photo is read.
struct SceneFiles {
  ColmapModel object;
  ColmapModel background;
  std::optional<TurntableFile> turntable;
  TrainMode mode = TrainMode::kStatic;
};

bool HasMasks(const fs::path& folder, const ColmapModel& model) {
  return Exists(folder) && std::any_of(model.images.begin(), model.images.end(), [&](const auto& item) {
           return !FindMask(folder, item.second.name).empty();
         });
}

SceneFiles ReadFiles(const TrainingScenePaths& paths, TrainMode mode, Reporter& reporter) {
  SceneFiles files;
  files.object = ReadColmapModel(paths.object_model);
  if (Exists(paths.turntable)) {
    files.turntable = ReadTurntableFile(paths.turntable);
    if (const std::optional<std::string> contradiction = FindContradiction(*files.turntable)) {
      reporter.Warn(paths.turntable.string() + ": " + *contradiction);
    }
  }
  const bool turns = files.turntable && TableTurns(*files.turntable);
  files.mode = mode;
  if (mode == TrainMode::kAuto) {
    files.mode = turns                                 ? TrainMode::kS2gs
                 : HasMasks(paths.masks, files.object) ? TrainMode::kMasks
                                                       : TrainMode::kStatic;
    reporter.Info(std::string("mode ") + TrainModeName(files.mode) +
                  (turns ? ": turntable.json says that the table turns"
                   : files.mode == TrainMode::kMasks
                       ? ": nothing turns by turntable.json, but there are masks"
                       : ": nothing turns by turntable.json, and there are no masks"));
  }
  if (files.mode == TrainMode::kS2gs && !turns) {
    throw UserError(
        paths.turntable,
        files.turntable ? "says that nothing turns" : "is missing, so how the table turned is unknown",
        "Run `s2gs turntable_mapper`, or train with --mode static or masks");
  }
  if (files.mode == TrainMode::kS2gs && Exists(paths.static_model)) {
    files.background = ReadColmapModel(paths.static_model);
  }
  return files;
}

// Poses of all photos that can be trained on, without pixels.
std::vector<ScenePhoto> CollectViews(const TrainingScenePaths& paths, const SceneFiles& files,
                                     std::vector<const Camera*>* cameras, Reporter& reporter) {
  std::map<std::string, const TurntableImage*> turns;
  if (files.turntable) {
    for (const TurntableImage& image : files.turntable->images) turns[image.name] = &image;
  }
  std::map<std::string, const ColmapImage*> statics;
  for (const auto& [id, image] : files.background.images) statics[image.name] = &image;

  std::map<std::string, const ColmapImage*> by_name;
  for (const auto& [id, image] : files.object.images) by_name[image.name] = &image;
  std::vector<ScenePhoto> photos;
  int64_t without_turn = 0;
  int64_t contradictions = 0;
  for (const auto& [name, image] : by_name) {
    ScenePhoto photo;
    photo.name = name;
    photo.view.cam_from_object = image->cam_from_world;
    photo.view.cam_from_world = image->cam_from_world;
    const auto turn = turns.find(name);
    if (turn != turns.end()) photo.station = turn->second->station;
    if (files.mode == TrainMode::kS2gs) {
      if (turn == turns.end()) {
        ++without_turn;
        continue;
      }
      photo.view.cam_from_world = image->cam_from_world * turn->second->world_from_object.Inverse();
      const auto fixed = statics.find(name);
      if (fixed != statics.end()) {
        const Rigid3 apart = fixed->second->cam_from_world * photo.view.cam_from_world.Inverse();
        const double reach = std::max(photo.view.cam_from_world.translation.norm(), 1e-12);
        if (apart.rotation.angularDistance(Eigen::Quaterniond::Identity()) > kPoseAgreement ||
            apart.translation.norm() > kPoseAgreement * reach) {
          ++contradictions;
        }
      }
    }
    cameras->push_back(&files.object.cameras.at(image->camera_id));
    photos.push_back(std::move(photo));
  }
  if (without_turn > 0) {
    reporter.Warn(std::to_string(without_turn) + " images of " + paths.object_model.string() +
                  " are not in turntable.json and are left out");
  }
  const auto without_pose = std::count_if(turns.begin(), turns.end(),
                                          [&](const auto& turn) { return by_name.count(turn.first) == 0; });
  if (without_pose > 0) {
    reporter.Warn(std::to_string(without_pose) + " images of " + paths.turntable.string() +
                  " have no pose in " + paths.object_model.string() + " and are left out");
  }
  if (contradictions > 0) {
    reporter.Warn(std::to_string(contradictions) + " images have another pose in " +
                  paths.static_model.string() +
                  " than sparse/0 and turntable.json together say; the latter count");
  }
  if (photos.empty()) {
    throw UserError(paths.object_model, "has no images to train on",
                    "Run `s2gs turntable_mapper`, or `colmap mapper`");
  }
  return photos;
}

std::vector<ScenePoint> CollectPoints(const SceneFiles& files) {
  std::vector<ScenePoint> points;
  points.reserve(files.object.points3D.size() + files.background.points3D.size());
  const bool rotates = files.mode != TrainMode::kStatic;
  for (const auto& [id, point] : files.object.points3D) points.push_back({point.xyz, point.rgb, rotates});
  for (const auto& [id, point] : files.background.points3D) points.push_back({point.xyz, point.rgb, false});
  return points;
}

bool IsBorneOut(const ColmapPoint3D& point) { return point.track.size() >= kRaysThatBearOut; }

std::optional<RotatingRegion> FindRegion(const SceneFiles& files) {
  if (files.mode != TrainMode::kS2gs || files.object.points3D.size() < kMinPointsForRegion)
    return std::nullopt;
  RotatingRegion region;
  region.axis = files.turntable->axis;
  // Two rays that meet may do so by chance, of someone who walks by, say; a third bears a point out.
  const size_t num_borne_out = std::count_if(files.object.points3D.begin(), files.object.points3D.end(),
                                             [](const auto& entry) { return IsBorneOut(entry.second); });
  const bool all_count = num_borne_out < kMinPointsForRegion;
  std::vector<double> radii;
  std::vector<double> heights;
  radii.reserve(files.object.points3D.size());
  heights.reserve(files.object.points3D.size());
  for (const auto& [id, point] : files.object.points3D) {
    if (!all_count && !IsBorneOut(point)) continue;
    const Eigen::Vector3d from_axis = point.xyz - region.axis.point;
    const double height = from_axis.dot(region.axis.direction);
    heights.push_back(height);
    radii.push_back((from_axis - height * region.axis.direction).norm());
  }
  region.radius = kRegionMargin * Quantile(std::move(radii), kRegionQuantile);
  region.low = Quantile(heights, 1 - kRegionQuantile);
  region.high = Quantile(std::move(heights), kRegionQuantile);
  const double slack =
      std::max((kRegionMargin - 1) * (region.high - region.low), kRegionSlack * region.radius);
  region.low -= slack;
  region.high += slack;
  return region;
}

std::set<std::string> HeldOutNames(const TrainingSceneOptions& options,
                                   const std::vector<ScenePhoto>& photos) {
  std::set<std::string> names;
  if (options.test_every > 0) {
    for (size_t i = 0; i < photos.size(); i += options.test_every) names.insert(photos[i].name);
  }
  if (options.test_list.empty()) return names;
  names.merge(ReadPhotoList(options.test_list, photos, "--test_list"));
  return names;
}

struct Loader {
  const TrainingScenePaths& paths;
  const TrainingSceneOptions& options;
  Reporter& reporter;
  std::map<uint32_t, Undistortion> undistortions;  // by camera

  // From several threads once a view of the camera is planned.
  const Undistortion& Plan(const Camera& camera) {
    const auto found = undistortions.find(camera.camera_id);
    if (found != undistortions.end()) return found->second;
    if (LensTurnsBack(camera)) {
      reporter.Warn(paths.object_model.string() + ": the lens of camera " + std::to_string(camera.camera_id) +
                    " turns back within its photos: what they show near their borders is left out");
    }
    return undistortions.emplace(camera.camera_id, PlanUndistortion(camera, paths.object_model))
        .first->second;
  }

  static void RequireSize(const fs::path& path, const Image8& image, const Camera& camera) {
    if (static_cast<uint64_t>(image.width) != camera.width ||
        static_cast<uint64_t>(image.height) != camera.height) {
      const bool turned = static_cast<uint64_t>(image.width) == camera.height &&
                          static_cast<uint64_t>(image.height) == camera.width;
      throw UserError(
          path,
          "is " + std::to_string(image.width) + " x " + std::to_string(image.height) +
              " pixels, its camera " + std::to_string(camera.width) + " x " + std::to_string(camera.height),
          turned ? "It seems to be turned by its EXIF orientation: give the photos as COLMAP saw them"
                 : "Give the photos that the model was made from");
    }
  }

  Image8 Undistort(const Image8& image, const Camera& camera) {
    const Undistortion& plan = Plan(camera);
    return UndistortImage(image, plan.source, plan.pinhole, reporter);
  }

  // The view at its size in training.
  void PlanView(const Camera& camera, ScenePhoto* photo) {
    PinholeView view = ViewOfPinhole(Plan(camera).pinhole);
    const int longer = std::max(view.width, view.height);
    const int most =
        photo->held_out && options.max_test_size > 0 ? options.max_test_size : options.max_image_size;
    if (longer > most) {
      const double scale = static_cast<double>(most) / longer;
      view = ResizeView(view, std::max(1, static_cast<int>(std::lround(view.width * scale))),
                        std::max(1, static_cast<int>(std::lround(view.height * scale))));
    }
    view.cam_from_world = photo->view.cam_from_world;
    view.cam_from_object = photo->view.cam_from_object;
    photo->view = view;
  }

  void Load(const Camera& camera, bool with_mask, bool needs_mask, ScenePhoto* photo) {
    const fs::path path = paths.images / photo->name;
    Image8 image = ReadImage(path, 3);
    RequireSize(path, image, camera);
    image = Undistort(image, camera);
    photo->image = ResizeByArea(image, photo->view.width, photo->view.height);
    if (with_mask) photo->mask = LoadMask(paths.masks, camera, needs_mask, *photo);
    if (photo->held_out && !paths.truth_masks.empty()) {
      photo->truth_mask = LoadMask(paths.truth_masks, camera, false, *photo);
    }
  }

  // Empty when there is none and none is needed.
  std::vector<uint8_t> LoadMask(const fs::path& folder, const Camera& camera, bool is_needed,
                                const ScenePhoto& photo) {
    fs::path path = FindMask(folder, photo.name);
    if (path.empty() && !is_needed) return {};
    if (path.empty()) path = folder / (photo.name + ".png");  // whose absence is the fault
    Image8 mask = ReadMask(path);
    RequireSize(path, mask, camera);
    // Before pixels are mixed with their neighbours: 128 counts as much as 255.
    Binarise(&mask);
    mask = Undistort(mask, camera);
    Binarise(&mask);
    mask = ResizeByArea(mask, photo.view.width, photo.view.height);
    Binarise(&mask);
    return std::move(mask.pixels);
  }

  static void Binarise(Image8* mask) {
    for (uint8_t& value : mask->pixels) value = value > 127 ? 255 : 0;
  }
};

// Where the cameras' axes meet, in the object's frame. Nothing when they are parallel.
std::optional<Eigen::Vector3d> AxesMeet(const std::vector<ScenePhoto>& photos) {
  constexpr double kMinSpread = 1e-3;  // of the axes, between 0 and 1 / 3.
  Eigen::Matrix3d normal_matrix = Eigen::Matrix3d::Zero();
  Eigen::Vector3d right_side = Eigen::Vector3d::Zero();
  for (const ScenePhoto& photo : photos) {
    const Eigen::Vector3d axis = photo.view.cam_from_object.rotation.conjugate() * Eigen::Vector3d::UnitZ();
    const Eigen::Vector3d centre = CameraCentre(photo.view.cam_from_object);
    const Eigen::Matrix3d across = Eigen::Matrix3d::Identity() - axis * axis.transpose();
    normal_matrix += across;
    right_side += across * centre;
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(normal_matrix);
  if (eigen.eigenvalues()[0] <= kMinSpread * eigen.eigenvalues()[2]) return std::nullopt;
  return normal_matrix.ldlt().solve(right_side);
}

void FindFocus(TrainingScene* scene) {
  const std::optional<Eigen::Vector3d> focus = AxesMeet(scene->photos);
  if (!focus) return;
  std::vector<double> radii;
  radii.reserve(scene->photos.size());
  for (const ScenePhoto& photo : scene->photos) {
    const PinholeView& view = photo.view;
    const double depth = (view.cam_from_object * *focus).z();
    const double half_angle_tan = std::max(view.width / view.fx, view.height / view.fy) / 2;
    if (depth > 0) radii.push_back(depth * std::sin(std::atan(half_angle_tan)));
  }
  if (2 * radii.size() < scene->photos.size()) return;  // they look away from each other
  scene->focus = *focus;
  scene->focus_radius = Quantile(std::move(radii), 0.5);
}

// Where the cameras look: the median rotating point, else the median point, else where their axes meet.
Eigen::Vector3d LookAt(const TrainingScene& scene) {
  const bool any_rotates =
      std::any_of(scene.points.begin(), scene.points.end(), [](const ScenePoint& p) { return p.rotates; });
  std::array<std::vector<double>, 3> coordinates;
  for (const ScenePoint& point : scene.points) {
    if (point.rotates != any_rotates) continue;
    for (int i = 0; i < 3; ++i) coordinates[i].push_back(point.x[i]);
  }
  if (!coordinates[0].empty()) {
    return {Quantile(coordinates[0], 0.5), Quantile(coordinates[1], 0.5), Quantile(coordinates[2], 0.5)};
  }
  if (const std::optional<Eigen::Vector3d> meeting = AxesMeet(scene.photos)) return *meeting;
  // Parallel axes and no points: the distance is unknown, one unit does.
  const PinholeView& view = scene.photos.front().view;
  return CameraCentre(view.cam_from_object) +
         view.cam_from_object.rotation.conjugate() * Eigen::Vector3d::UnitZ();
}

Rigid3 NormalisePose(const Rigid3& pose, const Eigen::Vector3d& origin, double size) {
  return {pose.rotation, (pose.rotation * origin + pose.translation) / size};
}

// Training itself is in normalised lengths, but the model's file has floats in the workspace's frame: far
// from its origin they round positions by more than a hundred thousandth of the scene.
void WarnFarFromOrigin(const TrainingScene& scene, const std::filesystem::path& path, Reporter& reporter) {
  const double rounding = scene.origin.norm() * 0x1p-24 / scene.size;
  if (rounding < 1e-5) return;
  reporter.Warn(path.string() + ": the scene lies " +
                std::to_string(std::llround(scene.origin.norm() / scene.size)) +
                " times its size from its frame's origin, so that files round positions to " +
                std::to_string(100 * rounding) +
                " % of its size. Move the model nearer (colmap model_transformer) to keep them exact");
}

}  // namespace

const char* TrainModeName(TrainMode mode) {
  switch (mode) {
    case TrainMode::kAuto:
      return "auto";
    case TrainMode::kS2gs:
      return "s2gs";
    case TrainMode::kMasks:
      return "masks";
    case TrainMode::kStatic:
      return "static";
  }
  return "";
}

OptionCheck TrainingSceneOptions::Check() const {
  if (max_image_size < 16) {
    return OptionFault{"max_image_size", std::to_string(max_image_size), "max_image_size >= 16"};
  }
  if (max_test_size != 0 && max_test_size < 16) {
    return OptionFault{"max_test_size", std::to_string(max_test_size),
                       "max_test_size = 0 or max_test_size >= 16"};
  }
  if (test_every < 0 || test_every == 1) {
    return OptionFault{"test_every", std::to_string(test_every), "test_every = 0 or test_every >= 2"};
  }
  return std::nullopt;
}

SceneBodies TrainingScene::bodies() const {
  switch (mode) {
    case TrainMode::kMasks:
      return SceneBodies::kObjectOnly;
    case TrainMode::kStatic:
      return SceneBodies::kStaticOnly;
    default:
      return SceneBodies::kBoth;
  }
}

bool IsOneStation(const TrainingScene& scene) {
  return std::all_of(scene.photos.begin(), scene.photos.end(),
                     [&](const ScenePhoto& photo) { return photo.station == scene.photos[0].station; });
}

std::set<std::string> ReadPhotoList(const fs::path& path, const std::vector<ScenePhoto>& photos,
                                    const std::string& option) {
  std::set<std::string> known;
  for (const ScenePhoto& photo : photos) known.insert(photo.name);
  std::set<std::string> names;
  std::istringstream lines(ReadWholeFile(path, kMaxListBytes, "Check " + option));
  std::string line;
  while (std::getline(lines, line)) {
    while (!line.empty() && std::isspace(static_cast<unsigned char>(line.back())) != 0) line.pop_back();
    if (line.empty()) continue;
    if (known.count(line) == 0) {
      throw UserError(path, "names " + line + ", which is no image of the scene",
                      "Give names as in sparse/0, one a line");
    }
    names.insert(line);
  }
  return names;
}

void NormaliseScene(TrainingScene* scene) {
  const Eigen::Vector3d look_at = LookAt(*scene);
  std::vector<double> distances;
  distances.reserve(scene->photos.size());
  for (const ScenePhoto& photo : scene->photos) {
    distances.push_back((CameraCentre(photo.view.cam_from_object) - look_at).norm());
  }
  const double size = Quantile(std::move(distances), 0.5);
  scene->origin = look_at;
  scene->size = size > 0 && std::isfinite(size) ? size : 1;
  FindFocus(scene);
  scene->focus = (scene->focus - scene->origin) / scene->size;
  scene->focus_radius /= scene->size;
  for (ScenePhoto& photo : scene->photos) photo.view = NormaliseView(photo.view, scene->origin, scene->size);
  for (ScenePoint& point : scene->points) point.x = (point.x - scene->origin) / scene->size;
  if (scene->axis) scene->axis->point = (scene->axis->point - scene->origin) / scene->size;
  if (scene->region) {
    scene->region->axis.point = (scene->region->axis.point - scene->origin) / scene->size;
    scene->region->radius /= scene->size;
    scene->region->low /= scene->size;
    scene->region->high /= scene->size;
  }
}

PinholeView NormaliseView(const PinholeView& view, const Eigen::Vector3d& origin, double size) {
  PinholeView normalised = view;
  normalised.cam_from_world = NormalisePose(view.cam_from_world, origin, size);
  normalised.cam_from_object = NormalisePose(view.cam_from_object, origin, size);
  return normalised;
}

Gaussians DenormaliseGaussians(Gaussians gaussians, const Eigen::Vector3d& origin, double size) {
  const auto log_size = static_cast<float>(std::log(size));
  for (size_t i = 0; i < gaussians.centre.size(); ++i) {
    gaussians.centre[i] = static_cast<float>(gaussians.centre[i] * size + origin[static_cast<int>(i % 3)]);
  }
  for (float& value : gaussians.log_scale) value += log_size;
  return gaussians;
}

Gaussians NormaliseGaussians(Gaussians gaussians, const Eigen::Vector3d& origin, double size) {
  const auto log_size = static_cast<float>(std::log(size));
  for (size_t i = 0; i < gaussians.centre.size(); ++i) {
    gaussians.centre[i] = static_cast<float>((gaussians.centre[i] - origin[static_cast<int>(i % 3)]) / size);
  }
  for (float& value : gaussians.log_scale) value -= log_size;
  return gaussians;
}

TrainingScene ReadTrainingScene(const TrainingScenePaths& paths, const TrainingSceneOptions& options,
                                Reporter& reporter,
                                const std::function<void(const TrainingSize&)>& before_photos) {
  const SceneFiles files = ReadFiles(paths, options.mode, reporter);
  TrainingScene scene;
  scene.mode = files.mode;
  std::vector<const Camera*> cameras;
  scene.photos = CollectViews(paths, files, &cameras, reporter);
  scene.points = CollectPoints(files);
  if (files.turntable) scene.axis = files.turntable->axis;
  scene.region = FindRegion(files);

  const std::set<std::string> held_out = HeldOutNames(options, scene.photos);
  if (held_out.size() >= scene.photos.size()) {
    throw UserError(paths.object_model, "all of its images are held out, none is left to train on",
                    "Hold out fewer");
  }
  const bool needs_mask = files.mode == TrainMode::kMasks;
  const bool with_mask = needs_mask || (options.masks_as_hint && Exists(paths.masks));
  Loader loader{paths, options, reporter, {}};
  TrainingSize size;
  size.num_photos = static_cast<int64_t>(scene.photos.size());
  size.num_points = static_cast<int64_t>(scene.points.size());
  int64_t largest_file = 0;
  for (size_t i = 0; i < scene.photos.size(); ++i) {
    ScenePhoto& photo = scene.photos[i];
    photo.held_out = held_out.count(photo.name) > 0;
    loader.PlanView(*cameras[i], &photo);
    const int64_t pixels = int64_t{photo.view.width} * photo.view.height;
    const int64_t bytes = (with_mask ? 4 : 3) * pixels;
    size.photo_bytes += bytes;
    if (!photo.held_out) size.trained_bytes += bytes;
    size.largest_view_px = std::max(size.largest_view_px, pixels);
    size.longest_side_px = std::max({size.longest_side_px, photo.view.width, photo.view.height});
    largest_file = std::max(largest_file, static_cast<int64_t>(cameras[i]->width * cameras[i]->height));
  }
  const int64_t bytes_of_one = std::max<int64_t>(1, kLoadingBytesPerPixel * largest_file);
  const auto at_once = static_cast<int>(std::clamp<int64_t>(
      kMostLoadingBytes / bytes_of_one, 1, std::min<int64_t>(size.num_photos, NumThreadsOf(0))));
  size.loading_bytes = at_once * bytes_of_one;
  if (before_photos) before_photos(size);
  std::atomic<int64_t> num_read = 0;
  ParallelFor(size.num_photos, at_once, [&](int64_t i) {
    if (reporter.StopRequested()) throw Interrupted();
    loader.Load(*cameras[static_cast<size_t>(i)], with_mask, needs_mask,
                &scene.photos[static_cast<size_t>(i)]);
    const int64_t done = ++num_read;
    const bool is_callers_thread = LoopThread() == 0;
    if (is_callers_thread && done < size.num_photos) reporter.Progress("read photos", done, size.num_photos);
  });
  reporter.Progress("read photos", size.num_photos, size.num_photos);
  if (options.equalise_exposure) {
    const ExposureSpread spread = EqualiseExposure(&scene.photos);
    if (spread.num_photos > 0) {
      reporter.Info(FormatText("exposure and white balance of %d photos made equal: gains of %.2f to %.2f",
                               spread.num_photos, spread.least, spread.greatest));
    }
  }
  NormaliseScene(&scene);
  WarnFarFromOrigin(scene, paths.object_model, reporter);
  return scene;
}

TrainingScene ReadScenePoses(const TrainingScenePaths& paths, TrainMode mode, Reporter& reporter) {
  const SceneFiles files = ReadFiles(paths, mode, reporter);
  TrainingScene scene;
  scene.mode = files.mode;
  std::vector<const Camera*> cameras;
  scene.photos = CollectViews(paths, files, &cameras, reporter);
  for (size_t i = 0; i < scene.photos.size(); ++i) {
    ScenePhoto& photo = scene.photos[i];
    PinholeView view = ViewOfPinhole(PlanUndistortion(*cameras[i], paths.object_model).pinhole);
    view.cam_from_world = photo.view.cam_from_world;
    view.cam_from_object = photo.view.cam_from_object;
    photo.view = view;
  }
  scene.points = CollectPoints(files);
  if (files.turntable) scene.axis = files.turntable->axis;
  scene.region = FindRegion(files);
  NormaliseScene(&scene);
  return scene;
}

}  // namespace s2gs
