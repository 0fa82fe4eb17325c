#include "tests/support/synthetic_photo_set.h"

#include <cmath>

#include "mesh/surface/triangle_mesh.h"
#include "s2gs/image/image_file.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/file_io.h"
#include "tests/support/synthetic_models.h"

namespace s2gs {
namespace {

std::string WithExtension(const std::string& name, const std::string& extension) {
  return std::filesystem::path(name).replace_extension(extension).string();
}

void WritePhotoAndMask(const std::filesystem::path& photo, const std::filesystem::path& masks,
                       const SyntheticRendering& rendering) {
  WriteImage(photo, rendering.rgb);
  WriteImage(masks / photo.filename().replace_extension(".png"), rendering.label);
}

}  // namespace

std::vector<View> SyntheticTestViews(const SyntheticTurntable& turntable,
                                     const SyntheticPhotoSetOptions& options) {
  std::vector<View> views;
  const std::vector<View>& train = turntable.scene.views;
  int in_station = 0;
  for (size_t i = 0; i < train.size(); ++i) {
    if (i > 0 && train[i].station != train[i - 1].station) in_station = 0;
    if (in_station >= options.test_images_per_station) continue;
    const double half_step_deg = turntable.options.turning ? turntable.options.step_deg / 2 : 0;
    const Eigen::Quaterniond turn(
        Eigen::AngleAxisd(half_step_deg * kPi / 180, turntable.scene.axis.direction));
    View view = train[i];
    view.name = WithExtension(view.name, "") + "_half" + options.extension;
    view.angle_deg += half_step_deg;
    view.world_from_object = Rigid3{turn, Eigen::Vector3d::Zero()} * view.world_from_object;
    views.push_back(view);
    ++in_station;
  }
  return views;
}

void WriteSyntheticPhotoSet(const std::filesystem::path& folder, SyntheticTurntable turntable,
                            const SyntheticRenderScene& scene, const SyntheticPhotoSetOptions& options) {
  const std::filesystem::path masks = folder / "gt" / "masks";
  CreateFolder(folder / "images");
  CreateFolder(folder / "images_test");
  CreateFolder(masks);
  for (size_t i = 0; i < turntable.scene.views.size(); ++i) {
    View& view = turntable.scene.views[i];
    view.name = WithExtension(view.name, options.extension);
    WritePhotoAndMask(folder / "images" / view.name, masks,
                      RenderImage(scene, turntable, static_cast<int>(i)));
  }
  const std::vector<View> test_views = SyntheticTestViews(turntable, options);
  for (const View& view : test_views) {
    const Rigid3 world_from_platter{
        Eigen::Quaterniond(Eigen::AngleAxisd(view.angle_deg * kPi / 180, turntable.scene.axis.direction)),
        Eigen::Vector3d::Zero()};
    WritePhotoAndMask(folder / "images_test" / view.name, masks,
                      Render(scene, turntable.scene.cameras[view.camera_id - 1], view.cam_from_world,
                             view.world_from_object, world_from_platter));
  }
  WritePlyMesh(folder / "gt" / "object.ply", Tessellate(scene.object, options.mesh_segments));
  WritePlyMesh(folder / "gt" / "disc.ply", Tessellate(scene.platter, options.mesh_segments));
  WriteSyntheticSceneJson(folder / "gt" / "scene.json", turntable, test_views);
}

}  // namespace s2gs
