#pragma once

#include <Eigen/Core>
#include <functional>
#include <vector>

#include "sfm_split/split/stations.h"

namespace s2gs {

/// Distance of a match of two pixel positions from an epipolar geometry [px], unsigned.
using MatchError = std::function<double(const Eigen::Vector2d& xy1, const Eigen::Vector2d& xy2)>;

/// How often a wrong match agrees with an epipolar geometry: the mean, over matches, of the share of the
/// directions into which a keypoint might have moved as far as it did that put it within max_error_px. What
/// hardly moves agrees with nearly any geometry, and so does what clings to the epipole; exchanging the
/// keypoints of matches among them does not see that.
double ChanceOfDirections(const Keypoints& keypoints1, const Keypoints& keypoints2,
                          const FeatureMatches& matches, const MatchError& error, double max_error_px);

/// One match of each detail, which may be found several times in several scales and directions: errors of the
/// others are not independent of its own. By place in the list given.
std::vector<int> DistinctDetails(const Keypoints& keypoints1, const Keypoints& keypoints2,
                                 const FeatureMatches& matches);

/// What the matches of two photos say of their poses.
struct PairProof {
  /// The poses are borne out, or a motion of the pair's own is: more matches agree with it than with the best
  /// of as many motions as matches can choose, were they all wrong.
  bool is_proven = false;
  /// A motion of the pair's own is proven by matches that the poses do not explain, more than those that they
  /// do, and nothing shows that two bodies move.
  bool is_contradicted = false;
  /// Two bodies are proven: the poses', and another with a motion that says nothing of the first one's
  /// matches (a hand, a person, a reflection).
  bool has_other_body = false;
  /// Matches of the proven motions, without those of another body. By place in the list given.
  std::vector<int> proven;
  std::vector<int> others;  ///< matches of another body.
};

/// \param matches  that may be the object's.
/// \param posed  distance of a match from the poses' epipolar geometry.
/// \param bound_px  at which it agrees.
/// \param risk  that chance alone proves something.
PairProof ProvePair(const Keypoints& keypoints1, const Keypoints& keypoints2, const FeatureMatches& matches,
                    const MatchError& posed, double bound_px, double risk);

}  // namespace s2gs
