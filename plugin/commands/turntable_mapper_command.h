#pragma once

#include "plugin/cli/command.h"

namespace s2gs {

/// `s2gs turntable_mapper`: object.db and static.db -> both sparse models in one frame, and turntable.json.
void RunTurntableMapper(CommandContext& context);

}  // namespace s2gs
