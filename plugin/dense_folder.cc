#include "plugin/dense_folder.h"

#include <system_error>

#include "mesh/dense_workspace.h"
#include "s2gs/photos.h"
#include "sfm_split/camera_model.h"
#include "sfm_split/colmap_model.h"
#include "sfm_split/error.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

ColmapModel ReadOrWrite(const Workspace& workspace, const fs::path& image_path, Reporter& reporter) {
  std::error_code ec;
  if (fs::exists(workspace.DenseModel(), ec)) return ReadColmapModel(workspace.DenseModel());
  reporter.Info("writing undistorted photos and cameras to " + workspace.Dense().string());
  return WriteDenseWorkspace(workspace.Dense(), ReadColmapModel(workspace.ObjectModel()),
                             {workspace.ObjectModel(), image_path, workspace.Masks()}, reporter);
}

}  // namespace

std::map<std::string, PinholeView> PrepareDenseFolder(const Workspace& workspace, const fs::path& image_path,
                                                      Reporter& reporter) {
  const ColmapModel model = ReadOrWrite(workspace, image_path, reporter);
  std::map<std::string, PinholeView> views;
  for (const auto& [id, image] : model.images) {
    const Camera& camera = model.cameras.at(image.camera_id);
    if (!IsDistortionFree(camera)) {
      throw UserError(workspace.DenseModel(),
                      "camera " + std::to_string(camera.camera_id) + " has distortion",
                      "Run `colmap image_undistorter` again, or remove dense/0");
    }
    views[image.name] = ViewOfPinhole(camera);
  }
  return views;
}

}  // namespace s2gs
