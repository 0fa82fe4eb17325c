#pragma once

#include "plugin/cli/command.h"

namespace s2gs {

/// Depth maps to mesh: --workspace_path W.
void RunTsdfMesher(CommandContext& context);

}  // namespace s2gs
