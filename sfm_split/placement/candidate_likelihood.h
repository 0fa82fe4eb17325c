#pragma once

#include <vector>

#include "sfm_split/base/reporter.h"
#include "sfm_split/circular_motion/circular_motion.h"
#include "sfm_split/circular_motion/match_triples.h"
#include "sfm_split/placement/scan_candidate.h"
#include "sfm_split/relocalise/match_likelihood.h"
#include "sfm_split/scene/scan_features.h"
#include "sfm_split/scene/scene.h"
#include "sfm_split/turntable/align_scene.h"

namespace s2gs {

/// Unknowns of a fit of circular motion: how each station's camera stands to the axis, its step or its
/// angles, lenses.
double UnknownsOf(const CircularMotion& motion);

/// Unknowns of a scene that was moved to where its matches are likeliest: poses of stations, a step of each,
/// lenses.
double UnknownsOf(const TurntableScene& scene);

/// What poses gain over the true ones in the likelihood of matches that they alone were fitted to, but for a
/// chance of e^-8: half of chi squared with a degree of freedom for each unknown.
double GainByFitting(double unknowns);

/// What all of a scan's matches say of poses, from whichever way of placing these came. Keeps references.
class CandidateLikelihood {
 public:
  explicit CandidateLikelihood(const ScanFeatures& features);

  /// Of the object, all of them.
  const std::vector<PossiblePair>& pairs() const { return pairs_; }
  /// Those inside stations.
  const std::vector<PossiblePair>& pairs_inside() const { return pairs_inside_; }

  /// Sets what all poses explain with lenses that there are, less what their unknowns cost, and that charge:
  /// half the logarithm of the matches that tell each (the Bayesian information criterion), a photo's own or
  /// a station's.
  void Judge(ScanCandidate* candidate) const;

  /// Whether poses that are not adjusted yet explain matches better than those of `best`, by more than their
  /// being fitted to these matches alone does. \param unknowns  as UnknownsOf has them.
  /// \param inside_stations  whether matches between stations are left out. \param how  they came, for the
  /// reporter.
  bool IsWorthAdjusting(const AlignedScene& aligned, double unknowns, bool inside_stations, const char* how,
                        const ScanCandidate& best, Reporter& reporter) const;

 private:
  // Of a scene's poses, whatever unknowns they have. \param of_pairs  its LikelihoodOfMatches().
  double LogPosterior(const MatchLikelihood& of_pairs, const AlignedScene& aligned) const;
  // What is known of the lenses before the matches are looked at.
  double LogPriorOfLenses(const TurntableScene& scene) const;

  const ScanFeatures& features_;
  const std::vector<PossiblePair> pairs_;
  const std::vector<PossiblePair> pairs_inside_;  // stations
  const std::vector<PhotoTriple> triples_;
};

}  // namespace s2gs
