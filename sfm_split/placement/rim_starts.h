#pragma once

#include <vector>

#include "sfm_split/base/reporter.h"
#include "sfm_split/joint_system/joint_priors.h"
#include "sfm_split/relocalise/match_likelihood.h"
#include "sfm_split/scene/scan_features.h"
#include "sfm_split/turntable/align_scene.h"

namespace s2gs {

/// A scene from which an adjustment starts.
struct RimStart {
  AlignedScene aligned;
  double sigma_px = 0;  ///< noise of right matches.
  double gain = 0;      ///< in the logarithm of the likelihood of matches inside stations, and of lenses.
};

/// Where the table's rim is the picture of a circle about the axis: each scene's stations are moved there
/// with focal lengths about those that it has, or as they are known, since a rim tells the axis before a
/// camera once its focal length is known; the likeliest, at most `most` of them, the best first. A rim moves
/// a station as a whole, which says nothing of how it lies to others: until an adjustment has brought them
/// together, matches between them tell how wide their errors are, and not the lens.
/// \param rims  by images of the features. \param pairs_inside  of the object, those inside stations.
std::vector<RimStart> StartsByRims(const ScanFeatures& features,
                                   const std::vector<PossiblePair>& pairs_inside,
                                   const std::vector<RimPrior>& rims, const std::vector<AlignedScene>& scenes,
                                   size_t most, Reporter& reporter);

}  // namespace s2gs
