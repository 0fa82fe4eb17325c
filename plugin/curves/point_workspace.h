#pragma once

#include <filesystem>
#include <string>

#include "plugin/stage/workspace.h"

namespace s2gs {

/// The workspace of one run: what `base` has of the stages before `from` (StandardStages), with their stamps,
/// so that they count as done. Files are hard links where the file system knows them, since every file is
/// replaced rather than changed; databases, which are changed in place, are copies; the photos are a link to
/// the folder. What is there already is removed first. Throws UserError.
void MakePointWorkspace(const Workspace& base, const std::string& from, const Workspace& point);

/// Removes all but what a comparison with other runs needs: models, turntable.json, the mesh, the log.
void ThinPointWorkspace(const Workspace& point);

}  // namespace s2gs
