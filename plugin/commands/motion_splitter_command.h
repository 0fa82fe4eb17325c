#pragma once

#include "plugin/cli/command.h"

namespace s2gs {

/// `s2gs motion_splitter`: features -> object.db, static.db and a label for each keypoint.
void RunMotionSplitter(CommandContext& context);

}  // namespace s2gs
