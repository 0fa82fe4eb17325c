#pragma once

#include "plugin/cli/command.h"

namespace s2gs {

/// Measures a workspace, or rendered images, against ground truth.
void RunScanEvaluator(CommandContext& context);

}  // namespace s2gs
