#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "mesh/fusion/depth_view.h"
#include "mesh/surface/object_view.h"
#include "plugin/stage/workspace.h"
#include "s2gs/image/image_file.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

/// The files of one view of dense/0; those that are not there have no path.
struct DenseViewFiles {
  std::string name;   ///< of the image.
  ObjectView camera;  ///< of the image, not of the maps.
  std::filesystem::path depth;
  std::filesystem::path normal;
  std::filesystem::path image;
  std::filesystem::path mask;
  std::filesystem::path table_seen;  ///< where the photo shows the table's top itself.
};

/// What to look for.
struct DenseViewRequest {
  std::filesystem::path mask_path;       ///< empty: dense/0/masks or, for photos without distortion, masks.
  std::string input_type = "geometric";  ///< of the maps' names: NAME.geometric.bin.
  bool use_normals = true;               ///< look for normal maps.
};

/// The views of dense/0/sparse, by name. Warns when masks do not fit the undistorted photos, and leaves them
/// out. Throws UserError for a model that cannot be read, cameras with distortion and a mask folder that is
/// not there.
std::vector<DenseViewFiles> FindDenseViews(const Workspace& workspace, const DenseViewRequest& request,
                                           Reporter& reporter);

/// The views' depth maps, with normals, photos and masks where there are any. All have depth maps.
class WorkspaceDepthViews : public DepthViewSource {
 public:
  explicit WorkspaceDepthViews(std::vector<DenseViewFiles> files) : files_(std::move(files)) {}
  int size() const override { return static_cast<int>(files_.size()); }
  std::shared_ptr<const DepthView> Load(int index) const override;

 private:
  std::vector<DenseViewFiles> files_;
};

/// The photos of those views that have one, with cameras of the photos' own size.
class DensePhotos {
 public:
  explicit DensePhotos(const std::vector<DenseViewFiles>& files);
  int size() const { return static_cast<int>(paths_.size()); }
  const ObjectView& Camera(int index) const { return cameras_[index]; }
  Image8 Load(int index, int channels) const { return ReadImage(paths_[index], channels); }
  /// Grey; without pixels where there is none.
  Image8 LoadMask(int index) const;
  /// Likewise.
  Image8 LoadTableSeen(int index) const;

 private:
  std::vector<ObjectView> cameras_;
  std::vector<std::filesystem::path> paths_;
  std::vector<std::filesystem::path> masks_;
  std::vector<std::filesystem::path> table_seen_;
};

}  // namespace s2gs
