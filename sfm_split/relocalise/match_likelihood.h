#pragma once

#include <vector>

#include "sfm_split/circular_motion/possible_matches.h"
#include "sfm_split/scene/scan_features.h"
#include "sfm_split/turntable/align_scene.h"

namespace s2gs {

/// How much better than chance a scene's poses explain the matches of its photos.
struct MatchLikelihood {
  double gain = 0;      ///< logarithm of the likelihood over that of chance alone.
  double sigma_px = 0;  ///< of a right match's epipolar error, inside stations where they have any.
  double inliers = 0;   ///< matches, each by its probability to be right.
};

/// Of all matches that may be the object's, right and wrong ones, verified or not: each has an epipolar error
/// that is normal if it is right, or what chance makes of it (in one station WrongMatches) if it is wrong;
/// the share of right ones is each pair's own, and sigma that of all. Photos that the scene lacks add
/// nothing. So one figure compares ways of placing the same photos: more photos, and matches that others
/// contradict, count for what they are. \param object_pairs  of PossibleObjectPairs(): all, or those inside
/// stations.
MatchLikelihood LikelihoodOfMatches(const ScanFeatures& features, const AlignedScene& aligned,
                                    const std::vector<PossiblePair>& object_pairs);

/// Matches that agree with a scene's poses.
struct ChosenMatches {
  std::vector<ImagePairMatches> pairs;  ///< those of each pair that has some.
  double variance = 1;                  ///< of poses that choose them so: VarianceOfChosen.
};

/// Of all matches, verified or not, of the pairs of photos that the scene has. Between stations that a
/// background places, what agrees better with cameras before which nothing turns is left out.
ChosenMatches MatchesThatAgree(const ScanFeatures& features, const AlignedScene& aligned,
                               double max_error_px);

}  // namespace s2gs
