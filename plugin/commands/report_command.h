#pragma once

#include "plugin/cli/command.h"

namespace s2gs {

void RunReport(CommandContext& context);

}  // namespace s2gs
