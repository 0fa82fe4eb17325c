#pragma once

#include "plugin/cli/command.h"

namespace s2gs {

/// Lists the stages of a workspace and its files.
void RunWorkspaceInfo(CommandContext& context);

}  // namespace s2gs
