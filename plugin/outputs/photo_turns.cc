#include "plugin/outputs/photo_turns.h"

#include <algorithm>

#include "sfm_split/base/file_io.h"
#include "sfm_split/scene/io/turntable_file.h"

namespace s2gs {

PhotoTurns::PhotoTurns(const Workspace& workspace, const std::vector<DenseViewFiles>& views) {
  if (!Exists(workspace.Turntable())) return;
  for (const TurntableImage& image : ReadTurntableFile(workspace.Turntable()).images)
    turns_[image.name] = image.world_from_object.rotation.toRotationMatrix();
  const bool knows_all = std::all_of(views.begin(), views.end(),
                                     [&](const DenseViewFiles& view) { return turns_.count(view.name) > 0; });
  if (!knows_all) turns_.clear();
}

Eigen::Matrix3d PhotoTurns::Of(const std::string& name) const {
  return turns_.empty() ? Eigen::Matrix3d::Identity() : turns_.at(name);
}

}  // namespace s2gs
