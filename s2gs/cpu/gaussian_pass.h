#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "s2gs/backend/backend.h"
#include "s2gs/core/gaussians.h"
#include "s2gs/cpu/tile_kernel.h"
#include "s2gs/kernel/foreground.h"
#include "s2gs/kernel/surfel.h"

namespace s2gs {

/// What all Gaussians of one view share.
struct ViewSetup {
  SplatCamera<float> camera;
  ForegroundRule rule = ForegroundRule::kSoft;
  DrawnSelection<float> selection;
  bool hard_map = false;  ///< the map of p shows the indicator p >= tau.
  int sh_degree = 0;
};

ViewSetup MakeViewSetup(const PinholeView& view, SceneBodies bodies, bool freeze_foreground, int sh_degree);

/// Gaussian i as a splat of the view. False, and an empty rectangle of pixels, when it is not drawn.
bool ProjectGaussian(const Gaussians& gaussians, size_t i, const ViewSetup& setup, SplatRow* row);

/// Gradients of a run of Gaussians, laid out as in Gaussians.
struct GaussianGradients {
  std::vector<float> centre, log_scale, rotation, opacity_logit, sh_dc, sh_rest, foreground_logit;

  void Resize(size_t count);
  void SetZero();
};

/// Takes the loss by Gaussian i's splat through projection and colour, into row `at` of `gradients`.
void ProjectGaussianAdjoint(const Gaussians& gaussians, size_t i, const ViewSetup& setup, const SplatRow& row,
                            const SplatGradient& d_row, size_t at, GaussianGradients* gradients);

}  // namespace s2gs
