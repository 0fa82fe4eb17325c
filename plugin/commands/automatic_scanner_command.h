#pragma once

#include "plugin/cli/command.h"

namespace s2gs {

/// `s2gs automatic_scanner`: photos to poses, model, masks and mesh by the other commands, one after another.
void RunAutomaticScanner(CommandContext& context);

}  // namespace s2gs
