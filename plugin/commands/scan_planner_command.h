#pragma once

#include "plugin/cli/command.h"

namespace s2gs {

/// Shows what a scan will do, what it leaves out and why: --workspace_path W or --image_path I.
void RunScanPlanner(CommandContext& context);

}  // namespace s2gs
