#pragma once

#include <filesystem>
#include <set>
#include <string>

#include "plugin/stage/workspace.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

/// Called when masks, maps and dense images of these photos are written. Removes those of photos of earlier
/// runs that are no longer among them, unless they were changed since they were written; what else lies in
/// these folders and belongs to no photo is not ours to remove, and named in a warning. Photos of this run
/// are noted for the next one, in s2gs/rendered.txt. \param image_path  the photos, which are never removed.
void TidyImageOutputs(const Workspace& workspace, const std::filesystem::path& image_path,
                      const std::set<std::string>& names, Reporter& reporter);

}  // namespace s2gs
