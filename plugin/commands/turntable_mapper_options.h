#pragma once

#include "plugin/cli/options.h"
#include "plugin/mapping/turntable_mapper_settings.h"

namespace s2gs {

/// Every option of the command, with what -h says of it.
void AddTurntableMapperOptions(Options& options, TurntableMapperSettings* settings);

}  // namespace s2gs
