#include "plugin/outputs/dense_views.h"

#include <fmt/format.h>

#include <map>
#include <utility>

#include "s2gs/image/photo_folder.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/file_io.h"
#include "sfm_split/scene/io/colmap_maps.h"
#include "sfm_split/scene/io/colmap_model.h"

namespace s2gs {
namespace {

namespace fs = std::filesystem;

// Masks are those of the photos, so they fit the dense images only when these are the photos.
fs::path MaskFolder(const Workspace& workspace, const DenseViewRequest& request, Reporter& reporter) {
  if (!request.mask_path.empty()) {
    if (!Exists(request.mask_path)) throw UserError(request.mask_path, "no such folder", "Check --mask_path");
    return request.mask_path;
  }
  if (Exists(workspace.DenseMasks())) return workspace.Dense() / "masks";
  if (!Exists(workspace.Masks())) return {};
  if (Exists(workspace.ObjectModel())) {
    const ColmapModel photos = ReadColmapModel(workspace.ObjectModel());
    for (const auto& [id, camera] : photos.cameras) {
      if (IsDistortionFree(camera)) continue;
      reporter.Warn(workspace.Masks().string() +
                    ": not used, because the photos were undistorted for dense/0 and the masks were not. Put "
                    "undistorted ones into dense/0/masks");
      return {};
    }
  }
  return workspace.Masks();
}

ObjectView PinholeOf(const Camera& camera, const ColmapImage& image, const fs::path& model) {
  if (!IsDistortionFree(camera)) {
    throw UserError(model,
                    fmt::format("camera {} is a {} with distortion, but depth maps need a pinhole",
                                camera.camera_id, InfoOf(camera.model).name),
                    "Run `colmap image_undistorter`, or `s2gs gaussian_renderer`");
  }
  const Eigen::Vector2d focal = FocalLengths(camera);
  const Eigen::Vector2d principal = PrincipalPoint(camera);
  return {static_cast<int>(camera.width),
          static_cast<int>(camera.height),
          focal.x(),
          focal.y(),
          principal.x(),
          principal.y(),
          image.cam_from_world};
}

}  // namespace

std::vector<DenseViewFiles> FindDenseViews(const Workspace& workspace, const DenseViewRequest& request,
                                           Reporter& reporter) {
  const ColmapModel model = ReadColmapModel(workspace.DenseModel());
  const fs::path masks = MaskFolder(workspace, request, reporter);
  std::map<std::string, const ColmapImage*> by_name;
  for (const auto& [id, image] : model.images) by_name[image.name] = &image;
  std::vector<DenseViewFiles> views;
  views.reserve(by_name.size());
  const std::string suffix = "." + request.input_type + ".bin";
  for (const auto& [name, image] : by_name) {
    const auto path_if_there = [](const fs::path& path) { return Exists(path) ? path : fs::path(); };
    DenseViewFiles files;
    files.name = name;
    files.camera = PinholeOf(model.cameras.at(image->camera_id), *image, workspace.DenseModel());
    files.depth = path_if_there(workspace.DepthMaps() / (name + suffix));
    if (request.use_normals) files.normal = path_if_there(workspace.NormalMaps() / (name + suffix));
    files.image = path_if_there(workspace.DenseImages() / name);
    if (!masks.empty()) files.mask = FindMask(masks, name);
    files.table_seen = path_if_there(workspace.TableSeen() / (name + ".png"));
    views.push_back(std::move(files));
  }
  return views;
}

std::shared_ptr<const DepthView> WorkspaceDepthViews::Load(int index) const {
  const DenseViewFiles& files = files_[index];
  ColmapMap depths = ReadColmapMap(files.depth, 1);
  const auto loaded = std::make_shared<DepthView>();
  DepthView& view = *loaded;
  view.camera = files.camera;
  // Maps of a smaller size show the whole image all the same.
  const double scale_x = static_cast<double>(depths.width) / files.camera.width;
  const double scale_y = static_cast<double>(depths.height) / files.camera.height;
  view.camera.width = depths.width;
  view.camera.height = depths.height;
  view.camera.fx *= scale_x;
  view.camera.cx *= scale_x;
  view.camera.fy *= scale_y;
  view.camera.cy *= scale_y;
  view.first_position = kColmapMapPosition;
  view.depths = std::move(depths.values);
  if (!files.normal.empty()) {
    ColmapMap normals = ReadColmapMap(files.normal, 3);
    if (normals.width != depths.width || normals.height != depths.height) {
      throw UserError(files.normal,
                      fmt::format("is {} x {}, but the depth map is {} x {}", normals.width, normals.height,
                                  depths.width, depths.height),
                      "Render both again");
    }
    view.normals = std::move(normals.values);
  }
  if (!files.image.empty()) view.colors = ReadImage(files.image, 3);
  if (!files.mask.empty()) view.mask = ReadMask(files.mask);
  return loaded;
}

DensePhotos::DensePhotos(const std::vector<DenseViewFiles>& files) {
  cameras_.reserve(files.size());
  paths_.reserve(files.size());
  masks_.reserve(files.size());
  for (const DenseViewFiles& view : files) {
    if (view.image.empty()) continue;
    const ImageSize size = ReadImageSize(view.image);
    ObjectView camera = view.camera;
    // Photos of another size show the whole image all the same.
    const double scale_x = static_cast<double>(size.width) / camera.width;
    const double scale_y = static_cast<double>(size.height) / camera.height;
    camera.width = size.width;
    camera.height = size.height;
    camera.fx *= scale_x;
    camera.cx *= scale_x;
    camera.fy *= scale_y;
    camera.cy *= scale_y;
    cameras_.push_back(camera);
    paths_.push_back(view.image);
    masks_.push_back(view.mask);
    table_seen_.push_back(view.table_seen);
  }
}

Image8 DensePhotos::LoadMask(int index) const {
  return masks_[index].empty() ? Image8() : ReadMask(masks_[index]);
}

Image8 DensePhotos::LoadTableSeen(int index) const {
  return table_seen_[index].empty() ? Image8() : ReadMask(table_seen_[index]);
}

}  // namespace s2gs
