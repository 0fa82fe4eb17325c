#pragma once

#include <vector>

#include "sfm_split/base/reporter.h"
#include "sfm_split/circular_motion/possible_matches.h"
#include "sfm_split/scene/scan_features.h"
#include "sfm_split/turntable/align_scene.h"

namespace s2gs {

/// What an ascent came to.
struct LikelihoodAscent {
  double before = 0;  ///< logarithm of the likelihood over that of chance, at the noise it ends with.
  double after = 0;
  double sigma_px = 0;  ///< of the epipolar error of the object's right matches, at the end.
};

/// Moves the stations' cameras, the angle at which each station begins and the focal lengths to where all
/// matches are likeliest, right and wrong ones, the object's inside and between stations and the background's
/// between stations, by the mixture of match_likelihood.h. Table angles inside a station stay as they are,
/// and a lens keeps what it maps in units of its focal length. Where the background places a station by a
/// degree wrong, most of the object's right matches between stations lie pixels off their lines, so that no
/// bound on errors finds them: the noise begins wide and narrows. Of scenes whose photos share their
/// station's camera, with two stations or more; others stay as they are, and `after` is `before`. The
/// background's model keeps its points, which are no longer where its cameras see them. Throws Interrupted
/// when the reporter asks to stop.
/// \param object_pairs  of PossibleObjectPairs(), also those between stations.
LikelihoodAscent AscendLikelihood(const ScanFeatures& features, const std::vector<PossiblePair>& object_pairs,
                                  Reporter& reporter, AlignedScene* aligned);

}  // namespace s2gs
