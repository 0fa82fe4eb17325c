#pragma once

#include <filesystem>
#include <nlohmann/json.hpp>
#include <vector>

#include "sfm_split/base/rigid3.h"
#include "sfm_split/scene/io/colmap_model.h"
#include "sfm_split/scene/io/turntable_file.h"
#include "tests/support/synthetic_turntable.h"

namespace s2gs {

/// The sparse model that COLMAP would make of the rotating part: exact camera-from-object poses, every
/// keypoint of every image (with its noise), and the exact object and platter points that two or more images
/// see. Image i has image_id i + 1, point i has point3D_id i + 1. After a flip the platter no longer moves
/// with the object: its keypoints of flipped images then see no point. \param model_from_object  moves and
/// scales the model, as SfM's arbitrary frame and unit do.
ColmapModel SyntheticObjectModel(const SyntheticTurntable& turntable, const Sim3& model_from_object = {});

/// The same for the background, with camera-from-world poses.
ColmapModel SyntheticStaticModel(const SyntheticTurntable& turntable, const Sim3& model_from_world = {});

/// The exact turntable.json.
TurntableFile SyntheticTurntableFile(const SyntheticTurntable& turntable);

/// Writes sparse/0, sparse/static and turntable.json into a workspace folder, which is created.
void WriteSyntheticWorkspace(const std::filesystem::path& workspace, const SyntheticTurntable& turntable,
                             ColmapFormat format = ColmapFormat::kBinary);

/// gt/scene.json as the data sets have it. Cameras with distortion also have `camera_params`.
/// \param test_views  held-out images, which have no other place in the turntable.
nlohmann::json SyntheticSceneJson(const SyntheticTurntable& turntable,
                                  const std::vector<View>& test_views = {});

/// Writes SyntheticSceneJson to `path`.
void WriteSyntheticSceneJson(const std::filesystem::path& path, const SyntheticTurntable& turntable,
                             const std::vector<View>& test_views = {});

}  // namespace s2gs
