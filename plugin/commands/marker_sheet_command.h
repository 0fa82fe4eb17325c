#pragma once

#include "plugin/cli/command.h"

namespace s2gs {

/// A sheet of markers for the table, to print: --output_path sheet.svg.
void RunMarkerSheet(CommandContext& context);

}  // namespace s2gs
