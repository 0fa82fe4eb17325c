#pragma once

#include <filesystem>
#include <string>

#include "plugin/stage/workspace.h"
#include "sfm_split/scene/io/colmap_model.h"
#include "sfm_split/scene/io/turntable_file.h"

namespace s2gs {

/// What model_scaler scales, as turntable_mapper left it. A run that was killed may have scaled the models
/// and not yet turntable.json, which is written last: then the copy that was taken first counts.
class UnscaledScene {
 public:
  /// Throws UserError where there is no scene.
  explicit UnscaledScene(const Workspace& workspace);

  /// Writes sparse/0, sparse/static, what split/turntable_mapper.json says in the scene's unit (the standard
  /// deviation of the axis' point) and turntable.json in metres. Throws UserError.
  void WriteInMetres(double metres_per_unit);

  ColmapModel object;
  ColmapModel background;  ///< empty where there is none.
  TurntableFile table;

 private:
  const Workspace workspace_;
  std::filesystem::path copy_;
};

}  // namespace s2gs
