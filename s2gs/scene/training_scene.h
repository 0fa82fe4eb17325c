#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "s2gs/backend/backend.h"
#include "s2gs/scene/training_size.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/reporter.h"
#include "sfm_split/base/rigid3.h"
#include "sfm_split/scene/scene.h"

namespace s2gs {

/// What is trained.
enum class TrainMode : uint8_t {
  kAuto,    ///< S2GS where turntable.json says that something turns, else masks where `masks` has any, else
            ///< static.
  kS2gs,    ///< both bodies, told apart by their motion.
  kMasks,   ///< 2DGS of the rotating part alone, in the object frame, cut out by masks.
  kStatic,  ///< 2DGS of everything, nothing turns.
};
const char* TrainModeName(TrainMode mode);

/// Where a scene lies. All but the first and the images may be absent.
struct TrainingScenePaths {
  std::filesystem::path object_model;  ///< COLMAP model of the rotating part, or of a static scene.
  std::filesystem::path static_model;  ///< COLMAP model of the background.
  std::filesystem::path turntable;     ///< turntable.json.
  std::filesystem::path images;
  std::filesystem::path masks;        ///< NAME.png; empty: none.
  std::filesystem::path truth_masks;  ///< the same, of held-out photos, to measure only; empty: none.
};

struct TrainingSceneOptions {
  TrainMode mode = TrainMode::kAuto;
  int max_image_size = 1600;        ///< longer side in training; larger photos are reduced [px].
  int max_test_size = 0;            ///< the same of held-out photos; 0: as in training [px].
  int test_every = 0;               ///< every n-th photo by name is held out; 0: none.
  std::filesystem::path test_list;  ///< names of held-out photos, one a line; empty: none.
  bool masks_as_hint = false;       ///< in mode S2GS: load the masks where there are any.
  bool equalise_exposure =
      true;  ///< take off what automatic exposure and white balance did (photo_exposure.h).

  OptionCheck Check() const;
};

/// A point of a sparse model.
struct ScenePoint {
  Eigen::Vector3d x;  ///< in the object frame, which is the world frame for those that do not rotate.
  Eigen::Matrix<uint8_t, 3, 1> rgb;
  bool rotates = false;
  int num_photos = 0;  ///< that show it, by its track.
};

/// One photo of the scene: undistorted, at its size in training or measuring.
struct ScenePhoto {
  std::string name;
  PinholeView view;
  Image8 image;                     ///< RGB
  std::vector<uint8_t> mask;        ///< as TrainingPhoto's.
  std::vector<uint8_t> truth_mask;  ///< the same, to measure only.
  bool held_out = false;
  int station = 0;
};

/// Everything that training starts from, in normalised lengths: x = (x_in_workspace - origin) / size.
struct TrainingScene {
  TrainMode mode = TrainMode::kStatic;  ///< never kAuto.
  Eigen::Vector3d origin = Eigen::Vector3d::Zero();
  double size = 1;                 ///< median distance of the cameras from the thing they look at.
  std::vector<ScenePhoto> photos;  ///< by name.
  std::vector<ScenePoint> points;
  std::optional<TurntableAxis> axis;     ///< with turntable.json.
  std::optional<RotatingRegion> region;  ///< known when there are points of the rotating part and an axis.
  /// What a photo shows of the place that all photos look at, as a sphere: where nothing turns, this is taken
  /// for the object.
  Eigen::Vector3d focus = Eigen::Vector3d::Zero();
  double focus_radius = 0;  ///< 0: the photos look at no common place.

  SceneBodies bodies() const;
};

/// Whether all photos were taken from one place, as far as what stands still tells.
bool IsOneStation(const TrainingScene& scene);

/// Reads the models, turntable.json, photos and masks. Photos of the model that are missing, damaged or of
/// another size than their camera are refused with their path, as are held-out names that do not exist.
/// \param before_photos  called once the size of all is known, and before the first photo is read, which an
///                       exception prevents.
TrainingScene ReadTrainingScene(const TrainingScenePaths& paths, const TrainingSceneOptions& options,
                                Reporter& reporter,
                                const std::function<void(const TrainingSize&)>& before_photos = {});

/// The same without photos: poses and points only. For rendering.
TrainingScene ReadScenePoses(const TrainingScenePaths& paths, TrainMode mode, Reporter& reporter);

}  // namespace s2gs
