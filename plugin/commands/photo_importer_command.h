#pragma once

#include "plugin/cli/command.h"

namespace s2gs {

/// Photos in other formats, or a video, to photos that COLMAP reads: --workspace_path W --image_path P.
void RunPhotoImporter(CommandContext& context);

}  // namespace s2gs
