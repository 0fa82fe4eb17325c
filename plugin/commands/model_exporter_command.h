#pragma once

#include "plugin/cli/command.h"

namespace s2gs {

/// A workspace in the files of other programs: --workspace_path W --output_path O --output_type T.
void RunModelExporter(CommandContext& context);

}  // namespace s2gs
