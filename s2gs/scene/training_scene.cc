#include "s2gs/scene/training_scene.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <set>
#include <string>

#include "s2gs/image/undistort.h"
#include "s2gs/scene/photo_exposure.h"
#include "s2gs/scene/photo_list.h"
#include "s2gs/scene/photo_reader.h"
#include "s2gs/scene/scene_files.h"
#include "s2gs/scene/scene_lengths.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/base/format_text.h"
#include "sfm_split/base/parallel_for.h"

namespace s2gs {
namespace {

constexpr int64_t kMostLoadingBytes = 2'000'000'000;  // of photos that are read at the same time
constexpr int64_t kLoadingBytesPerPixel =
    2 * (3 + 1);  // of a photo and its mask, as they are and undistorted

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

// All that files say but the photos. \param cameras  gets one for each photo, of `files`.
TrainingScene SceneOf(const TrainingScenePaths& paths, const SceneFiles& files,
                      std::vector<const Camera*>* cameras, Reporter& reporter) {
  TrainingScene scene;
  scene.mode = files.mode;
  scene.photos = CollectViews(paths, files, cameras, reporter);
  scene.points = CollectPoints(files);
  if (files.turntable) scene.axis = files.turntable->axis;
  scene.region = FindRegion(files);
  return scene;
}

// Which masks are read, and whether each photo must have one.
struct MaskUse {
  bool with_mask = false;
  bool needs_mask = false;
};

// Which photos are held out, and the size of each. Sums them up.
TrainingSize PlanPhotos(const std::set<std::string>& held_out, const std::vector<const Camera*>& cameras,
                        MaskUse masks, PhotoReader* reader, TrainingScene* scene) {
  TrainingSize size;
  size.num_photos = static_cast<int64_t>(scene->photos.size());
  size.num_points = static_cast<int64_t>(scene->points.size());
  for (size_t i = 0; i < scene->photos.size(); ++i) {
    ScenePhoto& photo = scene->photos[i];
    photo.held_out = held_out.count(photo.name) > 0;
    reader->PlanView(*cameras[i], &photo);
    const int64_t pixels = int64_t{photo.view.width} * photo.view.height;
    const int64_t bytes = (masks.with_mask ? 4 : 3) * pixels;
    size.photo_bytes += bytes;
    if (!photo.held_out) size.trained_bytes += bytes;
    size.largest_view_px = std::max(size.largest_view_px, pixels);
    size.longest_side_px = std::max({size.longest_side_px, photo.view.width, photo.view.height});
  }
  return size;
}

void ReadPhotos(const std::vector<const Camera*>& cameras, MaskUse masks, int at_once, PhotoReader* reader,
                TrainingScene* scene, Reporter& reporter) {
  const auto num_photos = static_cast<int64_t>(scene->photos.size());
  std::atomic<int64_t> num_read = 0;
  ParallelFor(num_photos, at_once, [&](int64_t i) {
    if (reporter.StopRequested()) throw Interrupted();
    reader->Read(*cameras[static_cast<size_t>(i)], masks.with_mask, masks.needs_mask,
                 &scene->photos[static_cast<size_t>(i)]);
    const int64_t done = ++num_read;
    const bool is_callers_thread = LoopThread() == 0;
    if (is_callers_thread && done < num_photos) reporter.Progress("read photos", done, num_photos);
  });
  reporter.Progress("read photos", num_photos, num_photos);
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

TrainingScene ReadTrainingScene(const TrainingScenePaths& paths, const TrainingSceneOptions& options,
                                Reporter& reporter,
                                const std::function<void(const TrainingSize&)>& before_photos) {
  const SceneFiles files = ReadSceneFiles(paths, options.mode, reporter);
  std::vector<const Camera*> cameras;
  TrainingScene scene = SceneOf(paths, files, &cameras, reporter);
  const std::set<std::string> held_out = HeldOutNames(options, scene.photos);
  if (held_out.size() >= scene.photos.size()) {
    throw UserError(paths.object_model, "all of its images are held out, none is left to train on",
                    "Hold out fewer");
  }
  MaskUse masks;
  masks.needs_mask = files.mode == TrainMode::kMasks;
  masks.with_mask = masks.needs_mask || (options.masks_as_hint && Exists(paths.masks));
  PhotoReader reader(paths, options, reporter);
  TrainingSize size = PlanPhotos(held_out, cameras, masks, &reader, &scene);
  int64_t largest_file = 0;
  for (const Camera* camera : cameras)
    largest_file = std::max(largest_file, static_cast<int64_t>(camera->width * camera->height));
  const int64_t bytes_of_one = std::max<int64_t>(1, kLoadingBytesPerPixel * largest_file);
  const auto at_once = static_cast<int>(std::clamp<int64_t>(
      kMostLoadingBytes / bytes_of_one, 1, std::min<int64_t>(size.num_photos, NumThreadsOf(0))));
  size.loading_bytes = at_once * bytes_of_one;
  if (before_photos) before_photos(size);
  ReadPhotos(cameras, masks, at_once, &reader, &scene, reporter);
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
  const SceneFiles files = ReadSceneFiles(paths, mode, reporter);
  std::vector<const Camera*> cameras;
  TrainingScene scene = SceneOf(paths, files, &cameras, reporter);
  for (size_t i = 0; i < scene.photos.size(); ++i) {
    ScenePhoto& photo = scene.photos[i];
    PinholeView view = ViewOfPinhole(PlanUndistortion(*cameras[i], paths.object_model).pinhole);
    view.cam_from_world = photo.view.cam_from_world;
    view.cam_from_object = photo.view.cam_from_object;
    photo.view = view;
  }
  NormaliseScene(&scene);
  return scene;
}

}  // namespace s2gs
