#pragma once

#include "plugin/cli/command.h"

namespace s2gs {

/// Sweeps one knob of one stage: error against run time, as CSV, JSON and an HTML page.
void RunWorkPrecision(CommandContext& context);

}  // namespace s2gs
