#pragma once

#include <map>
#include <vector>

#include "sfm_split/adjust/joint_ba.h"
#include "sfm_split/base/reporter.h"
#include "sfm_split/circular_motion/possible_matches.h"
#include "sfm_split/evidence/match_findings.h"
#include "sfm_split/scene/scan_features.h"
#include "sfm_split/turntable/align_scene.h"

namespace s2gs {

/// How well all matches, right and wrong ones, tell at what angle each station begins.
struct StationTurns {
  /// How many times farther the poses lie below the likelihood's top than the noise of matches alone would
  /// put the true ones, at least 1: half a unit for each number that the matches tell. Wrong matches err
  /// alike, and a keypoint is in many of them, so that logarithms of likelihoods are too large by as much.
  double overdispersion = 1;
  /// By station of the scene: standard deviation of its turn against the reference's [degrees]. Infinite
  /// where another turn is as likely. Of stations of four photos and more, none of them the reference's.
  std::map<int, double> sigma_deg;
};

/// Turns each station by a degree to either side, and to where else its matches agree, and lets all cameras,
/// focal lengths and the other stations' turns follow (the profile of the likelihood). Between stations, all
/// matches of one detail are one witness, and a match that agrees with cameras before which nothing turns may
/// be of what stands still. Without a background a station's turn is that of its camera about the axis
/// against the object. Of stations whose photos share a camera; of others there is nothing to say. Throws
/// Interrupted when the reporter asks to stop. \param object_pairs  of PossibleObjectPairs(), also those
/// between stations.
StationTurns AskStationTurns(const ScanFeatures& features, const std::vector<PossiblePair>& object_pairs,
                             const AlignedScene& aligned, Reporter& reporter);

/// Standard deviations of table angles are no smaller than those of their stations' turns. What has none (0,
/// negative or infinite) stays. \param joint  of the scene, its angles in the order of the scene's views.
void WidenByTurns(const TurntableScene& scene, const StationTurns& turns, JointReport* joint);

/// What all matches say of an adjusted scene; widens the standard deviations of its angles.
/// \param told_otherwise_deg  by station: standard deviation of a turn that matches need not tell.
/// \param joint  of the scene, as above.
MatchFindings AskMatches(const ScanFeatures& features, const std::vector<PossiblePair>& object_pairs,
                         const AlignedScene& aligned, const std::map<int, double>& told_otherwise_deg,
                         Reporter& reporter, JointReport* joint);

}  // namespace s2gs
