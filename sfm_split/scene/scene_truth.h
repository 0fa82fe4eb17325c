#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

#include "sfm_split/base/rigid3.h"
#include "sfm_split/scene/scene.h"

namespace s2gs {

/// One photo of a data set with ground truth.
struct SceneTruthImage {
  std::string file;      ///< relative to the data set's folder, e.g. "images/a.jpg".
  std::string name;      ///< the file name alone: unique in the data set, the key to a workspace's images.
  std::string mask;      ///< of labels, relative to the data set's folder; empty when there is none.
  bool is_train = true;  ///< false: held out.
  int station = 0;
  double angle_deg = 0;  ///< turn of the table, right-handed about the axis.
  Rigid3 cam_from_world;
  Rigid3 world_from_object;

  Rigid3 CamFromObject() const { return cam_from_world * world_from_object; }
};

/// What is known exactly about a data set: SCENE/gt/scene.json.
struct SceneTruth {
  std::filesystem::path folder;  ///< SCENE.
  std::string scene;
  std::string units;  ///< of all lengths, e.g. "metres".
  Camera camera;      ///< shared by all images; SIMPLE_PINHOLE is given as PINHOLE.
  TurntableAxis axis;
  uint8_t object_label = 255;  ///< in the masks of labels.
  uint8_t disc_label = 128;
  uint8_t static_label = 0;
  std::vector<SceneTruthImage> images;  ///< as listed in the file.

  /// Whether every object_to_world is the turn by the image's angle about the axis. Not so when the object
  /// was laid down in another way between stations.
  bool AxisIsFixedInObject() const;
  std::filesystem::path ObjectMeshPath() const { return folder / "gt" / "object.ply"; }
  std::filesystem::path DiscMeshPath() const { return folder / "gt" / "disc.ply"; }
};

/// Reads SCENE/gt/scene.json. Matrices must be rigid, the object_to_world of a station's images must differ
/// by turns by their angle_deg about the axis, names must be unique, the camera of a model that
/// ProjectToImage knows, with fx, fy, cx, cy and the other parameters by COLMAP's names (SIMPLE_RADIAL's k
/// also as k1), and the file must state COLMAP's pixel convention. Throws UserError with the path and the
/// entry at fault.
SceneTruth ReadSceneTruth(const std::filesystem::path& scene_folder);

/// The same from memory.
/// \param path  of the file, for messages and, two folders up, as the data set's folder.
SceneTruth ParseSceneTruth(std::string_view json, const std::filesystem::path& path);

}  // namespace s2gs
