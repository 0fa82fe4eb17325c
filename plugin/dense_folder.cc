#include "plugin/dense_folder.h"

#include <string_view>
#include <system_error>
#include <utility>

#include "s2gs/image_file.h"
#include "s2gs/photos.h"
#include "sfm_split/camera_model.h"
#include "sfm_split/colmap_model.h"
#include "sfm_split/error.h"
#include "sfm_split/file_io.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

constexpr uint64_t kMaxPhotoBytes = uint64_t{1} << 30;

void CopyFileAtomically(const fs::path& from, const fs::path& to) {
  const std::string bytes = ReadWholeFile(from, kMaxPhotoBytes, "Check --image_path");
  WriteFileAtomically(to, [&](std::ostream& stream) {
    stream.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  });
}

void WriteLines(const fs::path& path, const ColmapModel& model, std::string_view after_name) {
  WriteFileAtomically(path, [&](std::ostream& stream) {
    for (const auto& [id, image] : model.images) stream << image.name << '\n' << after_name;
  });
}

void MakeDenseFolder(const Workspace& workspace, const fs::path& image_path, Reporter& reporter) {
  const ColmapModel model = ReadColmapModel(workspace.ObjectModel());
  reporter.Info("writing undistorted photos and cameras to " + workspace.Dense().string());
  std::map<uint32_t, Undistortion> plans;
  ColmapModel dense;
  for (const auto& [id, camera] : model.cameras) {
    plans.emplace(id, PlanUndistortion(camera, workspace.ObjectModel()));
    dense.cameras[id] = plans.at(id).pinhole;
  }
  int64_t done = 0;
  for (const auto& [id, image] : model.images) {
    if (reporter.StopRequested()) throw Interrupted();
    const Undistortion& plan = plans.at(image.camera_id);
    const fs::path target = workspace.DenseImages() / image.name;
    CreateFolder(target.parent_path());
    if (IsDistortionFree(plan.source)) {
      CopyFileAtomically(image_path / image.name, target);
    } else {
      WriteImage(target, UndistortImage(plan, ReadImage(image_path / image.name, 3)));
    }
    ColmapImage kept = image;
    kept.points2D.clear();
    dense.images[id] = std::move(kept);
    reporter.Progress("undistort", ++done, static_cast<int64_t>(model.images.size()));
  }
  CreateFolder(workspace.DepthMaps());
  CreateFolder(workspace.NormalMaps());
  WriteLines(workspace.PatchMatchConfig(), model, "__auto__, 20\n");
  WriteLines(workspace.FusionConfig(), model, "");
  // Last: its presence says that the rest is complete.
  WriteColmapModel(workspace.DenseModel(), dense, ColmapFormat::kBinary);
}

}  // namespace

std::map<std::string, PinholeView> PrepareDenseFolder(const Workspace& workspace, const fs::path& image_path,
                                                      Reporter& reporter) {
  std::error_code ec;
  if (!fs::exists(workspace.DenseModel(), ec)) MakeDenseFolder(workspace, image_path, reporter);
  const ColmapModel model = ReadColmapModel(workspace.DenseModel());
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
