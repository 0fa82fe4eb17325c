#pragma once

#include <filesystem>
#include <map>
#include <string>

#include "plugin/stage/stage.h"
#include "plugin/stage/workspace.h"
#include "s2gs/backend/backend.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

/// The stage that writes dense/0.
constexpr char kUndistorterStage[] = "image_undistorter";

/// Makes sure that dense/0 is there as colmap image_undistorter leaves it: undistorted photos, their cameras
/// and poses, stereo/patch-match.cfg and fusion.cfg. Written again when sparse/0 or the photos changed. One
/// that COLMAP made, with the poses of sparse/0, is left as it is.
/// \param resample_always  photos without distortion too, which are copied otherwise.
/// \return  the intrinsics of every photo of dense/0/sparse, by name, without poses.
/// Throws UserError when photos are missing or an existing dense/0 has cameras with distortion.
std::map<std::string, PinholeView> PrepareDenseFolder(const Workspace& workspace,
                                                      const std::filesystem::path& image_path,
                                                      bool resample_always, StageRunner* runner,
                                                      Reporter& reporter);

}  // namespace s2gs
