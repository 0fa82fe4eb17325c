#pragma once

#include "plugin/cli/command.h"

namespace s2gs {

/// `s2gs scan_batch`: many objects.
void RunScanBatch(CommandContext& context);

}  // namespace s2gs
