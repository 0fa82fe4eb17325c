#pragma once

#include "plugin/cli/command.h"

namespace s2gs {

/// A mesh and photos to a textured mesh: --workspace_path W.
void RunMeshTexturer(CommandContext& context);

}  // namespace s2gs
