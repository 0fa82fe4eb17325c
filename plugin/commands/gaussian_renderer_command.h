#pragma once

#include "plugin/cli/command.h"

namespace s2gs {

/// `s2gs gaussian_renderer`: Gaussians -> images, masks, depth and normal maps at the photos' poses or on a
/// turn of the table.
void RunGaussianRenderer(CommandContext& context);

}  // namespace s2gs
