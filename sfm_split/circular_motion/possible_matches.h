#pragma once

#include <vector>

#include "sfm_split/circular_motion/wrong_matches.h"
#include "sfm_split/scene/scan_features.h"

namespace s2gs {

/// Matches of two photos that may be the object's, right and wrong ones, and for each the density of a wrong
/// match's epipolar error [1 / px].
struct PossiblePair {
  int image1 = 0;
  int image2 = 0;
  FeatureMatches matches;  ///< of many, an even choice.
  std::vector<double> chance;
  /// How far a right match moves at most, per chord of the table's turn on a circle of radius 1 [px]; 0
  /// between stations: no bound.
  double reach_px = 0;
  std::vector<double> weight;  ///< how much each counts for MatchAscent; empty: once.
};

/// How a match of two photos moved. \param turn  TurnBetween() of their places.
MatchMove MoveOf(const ScanFeatures& features, int image1, int image2, const FeatureMatch& match,
                 const Eigen::Vector2d& turn);

/// Of all pairs of photos, placed or not: what wrong matches look like is then the same for every scene. In
/// one station that is WrongMatches, between two stations they lie anywhere along the object.
/// \param within_stations  leave out pairs of photos of different stations.
std::vector<PossiblePair> PossibleObjectPairs(const ScanFeatures& features, bool within_stations);

/// Of photos that stand for their stations: matches of the background, wrong ones anywhere along it.
std::vector<PossiblePair> PossibleBackgroundPairs(const ScanFeatures& features);

}  // namespace s2gs
