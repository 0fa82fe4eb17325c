#include "sfm_split/placement/candidate_likelihood.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "sfm_split/joint_system/wobble_harmonics.h"
#include "sfm_split/relocalise/triple_likelihood.h"

namespace s2gs {
namespace {

constexpr double kCertain = 8;              // e^8 to one
constexpr double kCertainDeviations = 3.4;  // of a normal distribution: chance goes beyond once in e^8

// Half the logarithm of the matches that tell an unknown of the poses, for each (Schwarz): of a photo's own
// those of a photo, each of which is of two, and of a station's all.
double Charge(const ScanCandidate& candidate, double inliers) {
  const auto views = static_cast<double>(candidate.aligned.scene.views.size());
  double of_photos = views;  // its angle
  // Angles that lie about given steps are not unknown as far as these tell them.
  if (candidate.has_given_steps) {
    for (const double share : candidate.refined.joint.angle_prior_share) of_photos -= share;
  }
  double of_stations = 6.0 * candidate.aligned.scene.num_stations;
  if (candidate.refined.model == JointModel::kWobblingTable) {
    of_stations += WobbleHarmonics::kCoefficients * candidate.refined.joint.harmonics;
  } else if (candidate.refined.model != JointModel::kSharedStations) {
    of_photos += 6 * views;
  }
  return 0.5 * of_photos * std::log(std::max(2.0, 2 * inliers / std::max(1.0, views))) +
         0.5 * of_stations * std::log(std::max(2.0, inliers));
}

}  // namespace

double GainByFitting(double unknowns) {
  return 0.5 * unknowns + kCertainDeviations * std::sqrt(0.5 * unknowns);
}

double UnknownsOf(const CircularMotion& motion) {
  auto unknowns = static_cast<double>(motion.cameras.size());
  for (const char is_free : motion.distortion_is_free) unknowns += is_free != 0 ? 1 : 0;
  for (const CircularStationFit& fit : motion.stations) {
    if (!fit.found) continue;
    unknowns += 3 + (motion.steps_are_equal ? 1 : static_cast<double>(fit.angles_rad.size()) - 1);
  }
  return unknowns;
}

double UnknownsOf(const TurntableScene& scene) {
  return 7.0 * scene.num_stations + static_cast<double>(scene.cameras.size());
}

CandidateLikelihood::CandidateLikelihood(const ScanFeatures& features)
    : features_(features),
      pairs_(PossibleObjectPairs(features, false)),
      pairs_inside_(PossibleObjectPairs(features, true)),
      triples_(PossibleTriples(features)) {}

double CandidateLikelihood::LogPriorOfLenses(const TurntableScene& scene) const {
  double sum = 0;
  for (const Camera& camera : scene.cameras) {
    const auto given = features_.cameras.find(camera.camera_id);
    if (given == features_.cameras.end()) continue;
    sum += LogPriorOfLens(camera, given->second, HasPriorFocal(features_, camera.camera_id));
  }
  return sum;
}

double CandidateLikelihood::LogPosterior(const MatchLikelihood& of_pairs, const AlignedScene& aligned) const {
  return of_pairs.gain + GainOfTriples(features_, aligned, triples_, of_pairs.sigma_px) +
         LogPriorOfLenses(aligned.scene);
}

void CandidateLikelihood::Judge(ScanCandidate* candidate) const {
  const MatchLikelihood matches = LikelihoodOfMatches(features_, candidate->aligned, pairs_);
  candidate->charge = Charge(*candidate, matches.inliers);
  candidate->log_likelihood = LogPosterior(matches, candidate->aligned) - candidate->charge;
}

bool CandidateLikelihood::IsWorthAdjusting(const AlignedScene& aligned, double unknowns, bool inside_stations,
                                           const char* how, const ScanCandidate& best,
                                           Reporter& reporter) const {
  const std::vector<PossiblePair>& pairs = inside_stations ? pairs_inside_ : pairs_;
  const MatchLikelihood matches = LikelihoodOfMatches(features_, best.aligned, pairs);
  const double here = LogPosterior(LikelihoodOfMatches(features_, aligned, pairs), aligned);
  double there = LogPosterior(matches, best.aligned);
  // A pose for each photo follows wrong matches as well, and pays for it.
  if (best.refined.model != JointModel::kSharedStations) there -= Charge(best, matches.inliers);
  reporter.Debug("log-likelihood of the matches" + std::string(inside_stations ? " inside stations" : "") +
                 ": " + std::to_string(there) + ", by " + how + " " + std::to_string(here) + ", of which " +
                 std::to_string(GainByFitting(unknowns)) + " may come of " + std::to_string(unknowns) +
                 " unknowns");
  return here > there + GainByFitting(unknowns) + kCertain;
}

}  // namespace s2gs
