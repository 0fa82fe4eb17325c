#pragma once

#include <filesystem>
#include <functional>

#include "s2gs/image/image_file.h"
#include "s2gs/scene/training_scene.h"
#include "sfm_split/scene/io/colmap_model.h"
#include "sfm_split/scene/io/turntable_file.h"
#include "tests/support/synthetic_turntable.h"

namespace s2gs {

/// Writes a synthetic turntable as a workspace: sparse/0, sparse/static, turntable.json and images, by the
/// names of its views. \param photo  draws a view.
inline TrainingScenePaths WriteTurntableWorkspace(const std::filesystem::path& root,
                                                  const SyntheticTurntable& turntable,
                                                  const std::function<Image8(int view)>& photo) {
  const TrainingScenePaths paths = {
      root / "sparse" / "0", root / "sparse" / "static", root / "turntable.json", root / "images", {}, {}};
  ColmapModel object;
  ColmapModel background;
  for (const Camera& camera : turntable.scene.cameras) {
    object.cameras[camera.camera_id] = background.cameras[camera.camera_id] = camera;
  }
  TurntableFile file;
  file.axis = turntable.scene.axis;
  file.num_stations = turntable.scene.num_stations;
  for (size_t i = 0; i < turntable.scene.views.size(); ++i) {
    const View& view = turntable.scene.views[i];
    ColmapImage image;
    image.image_id = static_cast<uint32_t>(i + 1);
    image.name = view.name;
    image.camera_id = view.camera_id;
    image.cam_from_world = view.CamFromObject();
    object.images[image.image_id] = image;
    image.cam_from_world = view.cam_from_world;
    background.images[image.image_id] = image;
    file.images.push_back({view.name, view.station, view.angle_deg, view.world_from_object});
    std::filesystem::create_directories((paths.images / view.name).parent_path());
    WriteImage(paths.images / view.name, photo(static_cast<int>(i)));
  }
  uint64_t id = 1;
  for (const SyntheticPoint& point : turntable.points) {
    ColmapPoint3D p;
    p.point3D_id = id++;
    p.xyz = point.x;
    p.rgb = point.color;
    (IsRotating(point.body) ? object : background).points3D[p.point3D_id] = p;
  }
  WriteColmapModel(paths.object_model, object, ColmapFormat::kBinary);
  WriteColmapModel(paths.static_model, background, ColmapFormat::kBinary);
  WriteTurntableFile(paths.turntable, file);
  return paths;
}

}  // namespace s2gs
