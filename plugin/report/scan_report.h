#pragma once

#include <filesystem>

#include "plugin/stage/workspace.h"
#include "sfm_split/base/reporter.h"

namespace s2gs {

/// Writes report.html, one file that needs nothing besides, and report.json, the same numbers, from whatever
/// the workspace holds so far. The page says what is missing. Throws UserError when they cannot be written,
/// Interrupted.
/// \param image_path  the photos; empty: where the stages found them.
void WriteScanReport(const Workspace& workspace, const std::filesystem::path& image_path, Reporter& reporter);

}  // namespace s2gs
