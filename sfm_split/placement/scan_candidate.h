#pragma once

#include <string>

#include "sfm_split/evidence/match_findings.h"
#include "sfm_split/relocalise/scan_refinement.h"
#include "sfm_split/turntable/align_scene.h"

namespace s2gs {

/// One way of placing the object (free SfM, circular motion, the single axis), adjusted.
struct ScanCandidate {
  AlignedScene aligned;
  RefineReport refined;
  std::string finding;  ///< what came of it, for the report.
  bool is_usable = false;
  bool has_given_steps = false;  ///< its angles were adjusted about equal steps (RefineOptions::equal_steps).

  /// Of all matches, by LikelihoodOfMatches, less what the Bayesian information criterion charges for the
  /// poses' unknowns: ways of placing the same photos compare by it, whichever comes first.
  double log_likelihood = 0;
  double charge = 0;  ///< that log_likelihood has been lessened by.

  MatchFindings matches;  ///< of the poses that were taken; nothing is known of others.

  bool IsBetterThan(const ScanCandidate& other) const {
    if (is_usable != other.is_usable) return is_usable;
    return log_likelihood > other.log_likelihood;
  }
};

}  // namespace s2gs
