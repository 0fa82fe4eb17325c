#pragma once

#include <filesystem>
#include <string_view>

#include "plugin/stage/workspace.h"
#include "sfm_split/scene/io/colmap_model.h"

namespace s2gs {

/// Throws UserError when what an export writes, a file or a folder with all below it, would lie among the
/// photos or in what the workspace itself has.
void RequireFreePlace(const Workspace& workspace, const std::filesystem::path& image_path,
                      const std::filesystem::path& place);

/// Writes a file of an export, of which there are many: a picture that lies there already may be a photo, or
/// a mask that was mended by hand. Throws UserError when it has another content.
void WriteUnlessOther(const std::filesystem::path& path, std::string_view content);

/// Throws UserError when the folder holds a model other than this one, by its images and their poses and by
/// the number of its points.
void RequireNoOtherModel(const std::filesystem::path& folder, const ColmapModel& model);

}  // namespace s2gs
