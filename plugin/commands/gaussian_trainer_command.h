#pragma once

#include "plugin/cli/command.h"

namespace s2gs {

/// `s2gs gaussian_trainer`: posed photos -> Gaussians that know whether they belong to the rotating part.
void RunGaussianTrainer(CommandContext& context);

}  // namespace s2gs
