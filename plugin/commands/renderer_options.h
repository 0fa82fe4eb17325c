#pragma once

#include "plugin/cli/options.h"
#include "plugin/outputs/scene_renderer.h"

namespace s2gs {

/// Adds all of them, those of the backend too.
void AddRendererOptions(Options* options, RendererArguments* arguments);

}  // namespace s2gs
