#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "s2gs/backend/backend.h"

namespace s2gs {

/// The slow, obvious renderer and loss, in double: every pixel against every splat, rays met with planes as
/// in a textbook, no tiles, no bounds. What both backends are compared with.

/// One Gaussian's parameters in the order of ReferenceField.
enum ReferenceField {
  kRefCentre = 0,
  kRefLogScale = 3,
  kRefRotation = 5,
  kRefOpacity = 9,
  kRefForeground = 10,
  kRefDc = 11,
  kRefRest = 14,
  kRefCount = 14 + 3 * kShRestPerChannel
};
using ReferenceGaussian = std::array<double, kRefCount>;

std::vector<ReferenceGaussian> ToReference(const Gaussians& gaussians);
Gaussians FromReference(const std::vector<ReferenceGaussian>& gaussians, int sh_degree);

struct ReferenceMaps {
  std::vector<double> color, alpha, expected_depth, median_depth, normal, distortion, foreground;
};

/// Maps as RenderedView has them; all of them.
ReferenceMaps RenderReference(const std::vector<ReferenceGaussian>& gaussians, const RenderRequest& request,
                              int sh_degree);

/// Loss of one step. \param neighbours  k per Gaussian.
LossTerms ReferenceLoss(const std::vector<ReferenceGaussian>& gaussians, const TrainingPhoto& photo,
                        const TrainStep& step, const std::vector<uint32_t>& neighbours, int k);

}  // namespace s2gs
