#include "plugin/outputs/dense_folder.h"

#include <system_error>

#include "mesh/io/dense_workspace.h"
#include "s2gs/image/photos.h"
#include "sfm_split/base/error.h"
#include "sfm_split/scene/camera_model.h"
#include "sfm_split/scene/io/colmap_model.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

// Poses that differ by more are not those that the folder was made from.
constexpr double kSamePose = 1e-9;

bool HasPosesOf(const ColmapModel& model, const fs::path& dense_model) {
  const ColmapModel dense = ReadColmapModel(dense_model);
  if (dense.images.size() != model.images.size()) return false;
  for (const auto& [id, image] : model.images) {
    const auto found = dense.images.find(id);
    if (found == dense.images.end() || found->second.name != image.name) return false;
    const Eigen::Matrix4d difference = found->second.cam_from_world.Matrix() - image.cam_from_world.Matrix();
    if (!(difference.cwiseAbs().maxCoeff() <= kSamePose)) return false;
  }
  return true;
}

}  // namespace

std::map<std::string, PinholeView> PrepareDenseFolder(const Workspace& workspace, const fs::path& image_path,
                                                      bool resample_always, StageRunner* runner,
                                                      Reporter& reporter) {
  const ColmapModel model = ReadColmapModel(workspace.ObjectModel());
  std::error_code ec;
  const bool is_ours = ReadStageStamp(workspace, kUndistorterStage, reporter).has_value();
  if (is_ours || !fs::exists(workspace.DenseModel(), ec) || !HasPosesOf(model, workspace.DenseModel())) {
    std::map<std::string, std::string> options;
    if (resample_always) options["undistort_always"] = "1";
    const Stage stage = {kUndistorterStage,
                         {workspace.ObjectModel(), image_path},
                         options,
                         {workspace.DenseImages(), workspace.DenseModel()},
                         {},
                         {workspace.Dense()}};
    runner->Run(stage, [&] {
      // Its presence says that the folder is complete.
      fs::remove_all(workspace.DenseModel(), ec);
      WriteDenseWorkspace(workspace.Dense(), model,
                          {workspace.ObjectModel(), image_path, {}, workspace.root, resample_always},
                          reporter);
    });
  }
  const ColmapModel dense = ReadColmapModel(workspace.DenseModel());
  std::map<std::string, PinholeView> views;
  for (const auto& [id, image] : dense.images) {
    const Camera& camera = dense.cameras.at(image.camera_id);
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
