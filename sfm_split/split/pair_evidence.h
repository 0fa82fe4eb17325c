#pragma once

#include <vector>

#include "sfm_split/split/motion_split.h"

namespace s2gs {

/// How much better than chance an epipolar fit is: log10 of the number of fundamental matrices that this many
/// matches of random places would be expected to agree with as well (a contrario; Moisan and Stival 2004).
/// Below kMaxLogFalseAlarms a fit is no accident, however few its inliers.
/// \param inlier_probability  of a random match: the share of its image's area that lies near a line.
double LogFalseAlarms(int num_inliers, int num_matches, double inlier_probability);

/// A fit that is so much better than chance is no accident: by chance there is one in a hundred pairs.
constexpr double kMaxLogFalseAlarms = -2;

/// The probability that LogFalseAlarms asks for: a band of `max_error_px` on both sides of a line through the
/// box that the matches fill, over the box.
double EpipolarInlierProbability(const Keypoints& keypoints1, const Keypoints& keypoints2,
                                 const FeatureMatches& matches, const std::vector<int>& subset,
                                 double max_error_px);

/// What third images say about the matches of one pair: match (a, b) is confirmed by an image in which a and
/// b are matched to one place, and contradicted by one in which they are matched to two.
struct PairSupport {
  int num_confirmed = 0;     ///< matches with more confirmations than contradictions.
  int num_contradicted = 0;  ///< matches with more contradictions.
  std::vector<int> balance;  ///< per match: confirmations minus contradictions.
};

/// The support of every pair by all the others.
/// \param keypoints  per image.
std::vector<PairSupport> FindPairSupport(const std::vector<Keypoints>& keypoints,
                                         const std::vector<VerifiedPair>& pairs);

/// Takes out pairs that third images contradict, pairs that nothing confirms and chance could explain, and
/// the single matches that are contradicted. Repeats, because every pair taken out was a witness.
/// \param min_inliers  a pair left with fewer matches is taken out, too.
void RemoveContradicted(const std::vector<Keypoints>& keypoints, int min_inliers,
                        std::vector<VerifiedPair>* pairs);

}  // namespace s2gs
