#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <set>
#include <string>

#include "plugin/shared_options/backend_choice.h"
#include "plugin/stage/workspace.h"
#include "s2gs/core/pinhole_view.h"
#include "s2gs/view_maps.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

/// What depth maps, normal maps and silhouettes show.
enum class MapsOf : uint8_t { kObject, kAll };

/// Whose a table's top is where photos do not tell whether it turns.
enum class PlainTable : uint8_t { kObject, kBackground };

/// What gaussian_renderer is told.
struct RendererArguments {
  std::filesystem::path workspace_path;
  std::filesystem::path image_path;
  std::filesystem::path model_path;
  std::filesystem::path output_path;
  std::filesystem::path image_list;
  bool color = false;
  bool foreground = false;
  bool masks = true;
  bool stereo = true;
  bool pictures = false;
  bool comparison = false;
  bool overview = true;
  DepthKind depth = DepthKind::kMedian;
  MapsOf maps_of = MapsOf::kObject;
  bool undistort_always = false;
  PlainTable plain_table = PlainTable::kObject;
  bool cut_at_table = true;
  bool clear_plain_top = true;
  bool table_seen = true;
  int32_t num_frames = 0;
  int32_t frame_station = 0;
  BackendChoice backend;
};

/// Renders a trained model at the poses of a workspace's photos. The model is read when the first picture is
/// wanted; everything throws UserError with the path that is missing or damaged, and Interrupted. What it is
/// made from has to live as long.
class SceneRenderer {
 public:
  SceneRenderer(const RendererArguments& arguments, const Workspace& workspace, Reporter& reporter);
  ~SceneRenderer();

  /// What other stages and COLMAP work on, and an overview. \param dense_views  of dense/0, by name of photo;
  /// photos without one get no maps.
  void RenderForWorkspace(const std::map<std::string, PinholeView>& dense_views);
  /// Images to look at.
  void RenderPictures();
  /// One turn of the table before a camera that stands still.
  void RenderFrames();

  std::set<std::string> PhotoNames();  ///< Of all photos, rendered or not.
  size_t num_photos() const;           ///< That were asked for; 0 before the first picture.

 private:
  class LazyRenderer;
  const RendererArguments& a_;
  const Workspace& workspace_;
  Reporter& reporter_;
  std::unique_ptr<LazyRenderer> lazy_;
};

}  // namespace s2gs
