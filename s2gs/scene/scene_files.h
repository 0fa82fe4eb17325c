#pragma once

#include <optional>
#include <vector>

#include "s2gs/scene/training_scene.h"
#include "sfm_split/base/reporter.h"
#include "sfm_split/scene/camera_model.h"
#include "sfm_split/scene/io/colmap_model.h"
#include "sfm_split/scene/io/turntable_file.h"

namespace s2gs {

/// What a workspace's files say before any photo is read.
struct SceneFiles {
  ColmapModel object;
  ColmapModel background;  ///< empty where nothing turns.
  std::optional<TurntableFile> turntable;
  TrainMode mode = TrainMode::kStatic;  ///< never kAuto.
};

/// Reads the models and turntable.json. Throws UserError, also where the mode needs a table that turns and
/// there is none.
SceneFiles ReadSceneFiles(const TrainingScenePaths& paths, TrainMode mode, Reporter& reporter);

/// Poses of all photos that can be trained on, by name, without pixels or intrinsics. Warns of photos that
/// are left out and of poses that contradict each other. Throws UserError when there are none. \param cameras
/// gets one for each photo, of `files`.
std::vector<ScenePhoto> CollectViews(const TrainingScenePaths& paths, const SceneFiles& files,
                                     std::vector<const Camera*>* cameras, Reporter& reporter);

/// The points of both models, in the workspace's lengths.
std::vector<ScenePoint> CollectPoints(const SceneFiles& files);

/// Where the rotating part is, by its points; nothing when they are few or nothing turns. In the workspace's
/// lengths.
std::optional<RotatingRegion> FindRegion(const SceneFiles& files);

}  // namespace s2gs
