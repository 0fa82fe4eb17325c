#pragma once

#include <vector>

#include "sfm_split/rim/rim_search.h"
#include "sfm_split/rim/searched_circles.h"

namespace s2gs {

/// A circle along whose picture edges lie.
struct RimCandidate {
  CircleUnknowns x;
  double score = 0;
};

/// Circles of the search along whose pictures edges lie, the clearest first, and how many there are that a
/// pixel of the picture tells apart.
struct RimCandidates {
  std::vector<RimCandidate> starts;
  double num_tried = 0;
};
RimCandidates FindRimCandidates(const RimView& view, const RimSearch& search);

}  // namespace s2gs
