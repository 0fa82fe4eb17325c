#pragma once

#include <vector>

#include "s2gs/backend/backend.h"
#include "s2gs/core/gaussians.h"
#include "sfm_split/base/thread_pool.h"

namespace s2gs {

/// Means of (10) and (11) over all Gaussians (and neighbours).
struct ForegroundTerms {
  double local_consistency = 0;
  double entropy_3d = 0;
};

/// Computes both terms as far as their weights are not 0, and the weighted loss by the logits of p.
/// \param neighbours  k per Gaussian.
/// The result does not depend on the number of threads.
ForegroundTerms RegulariseForeground(const std::vector<float>& foreground_logit,
                                     const std::vector<uint32_t>& neighbours, int k,
                                     const LossWeights& weights, ThreadPool* threads,
                                     std::vector<float>* d_logit);

/// A view's maps that (12), the masks' hint and the normals work on, and where the loss by them is added to.
struct ViewLossTerms {
  double normal = 0;
  double distortion = 0;
  double entropy_2d = 0;
  double mask = 0;
};

struct ViewMaps {
  const PinholeView* view = nullptr;
  size_t stride = 0;
  const float* transmittance = nullptr;
  const float* foreground = nullptr;
  const float* normal[3] = {};
  const float* weight = nullptr;  ///< sum of w.
  const float* depth = nullptr;   ///< sum of w z.
  const float* distortion = nullptr;
  const uint8_t* mask = nullptr;  ///< of the photo, height * width; null: none.
  float* d_alpha = nullptr;
  float* d_foreground = nullptr;
  float* d_normal[3] = {};
  float* d_expected_depth = nullptr;
  float* d_distortion = nullptr;
};

/// Means over all pixels of the terms whose weights are not 0; overwrites the gradients of the maps that they
/// use, and sets those of unused ones that are not null to 0.
ViewLossTerms RegulariseView(const ViewMaps& maps, const LossWeights& weights, ThreadPool* threads);

}  // namespace s2gs
