#pragma once

#include "plugin/cli/command.h"

namespace s2gs {

/// Sparse models and turntable.json to metres, by markers or a length that is known: --workspace_path W.
void RunModelScaler(CommandContext& context);

}  // namespace s2gs
