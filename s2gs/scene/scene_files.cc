#include "s2gs/scene/scene_files.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <filesystem>
#include <map>
#include <string>
#include <utility>

#include "s2gs/image/photo_folder.h"
#include "s2gs/image/photos.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

constexpr double kPoseAgreement = 1e-3;  // of the two models' poses, in radians and scene sizes.

bool HasMasks(const fs::path& folder, const ColmapModel& model) {
  return Exists(folder) && std::any_of(model.images.begin(), model.images.end(), [&](const auto& item) {
           return !FindMask(folder, item.second.name).empty();
         });
}

bool Agree(const Rigid3& of_background, const Rigid3& cam_from_world) {
  const Rigid3 apart = of_background * cam_from_world.Inverse();
  const double reach = std::max(cam_from_world.translation.norm(), 1e-12);
  return !(apart.rotation.angularDistance(Eigen::Quaterniond::Identity()) > kPoseAgreement ||
           apart.translation.norm() > kPoseAgreement * reach);
}

}  // namespace

SceneFiles ReadSceneFiles(const TrainingScenePaths& paths, TrainMode mode, Reporter& reporter) {
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
      if (fixed != statics.end() && !Agree(fixed->second->cam_from_world, photo.view.cam_from_world))
        ++contradictions;
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
  const auto add = [&points](const ColmapPoint3D& point, bool is_rotating) {
    points.push_back({point.xyz, point.rgb, is_rotating, static_cast<int>(point.track.size())});
  };
  for (const auto& [id, point] : files.object.points3D) add(point, rotates);
  for (const auto& [id, point] : files.background.points3D) add(point, false);
  return points;
}

}  // namespace s2gs
