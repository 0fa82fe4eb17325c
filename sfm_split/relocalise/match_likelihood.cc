#include "sfm_split/relocalise/match_likelihood.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <optional>
#include <utility>
#include <vector>

#include "sfm_split/adjust/match_errors.h"
#include "sfm_split/adjust/posed_images.h"
#include "sfm_split/adjust/track_triangulation.h"
#include "sfm_split/base/infinity.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/circular_motion/match_mixture.h"

namespace s2gs {
namespace {

constexpr double kFirstSigmaPx = 1;  // about what keypoints are good to; the rounds correct it
constexpr int kRounds = 8;           // at most; settled to a hundredth

struct Error {
  double px = 0;
  double chance = 0;  // density of a wrong match's error
};

struct PairErrors {
  bool is_one_station = true;
  std::vector<Error> errors;
};

// One round of expectation and maximisation over all pairs' errors. Matches inside stations tell the noise
// where there are any: between stations, shading that hardly turns lies alike off its lines in all of them,
// and widens it until it is right.
MatchLikelihood Round(const std::vector<PairErrors>& pairs, double sigma_px) {
  MatchLikelihood result;
  double squares[2] = {0, 0};  // between stations, inside
  double inliers[2] = {0, 0};
  std::vector<double> over;  // density of a right match's error over that of a wrong one's
  const double peak = 1 / (sigma_px * kRootTwoPi);
  for (const PairErrors& pair : pairs) {
    over.clear();
    for (const Error& error : pair.errors) {
      const double ratio = error.px / sigma_px;
      over.push_back(std::isfinite(error.px) ? OverChance(peak / error.chance, -0.5 * ratio * ratio) : 0);
    }
    const double share = RightShare(over);
    result.gain += MixtureGain(over, share);
    for (size_t m = 0; m < over.size(); ++m) {
      const double right = RightProbability(over[m], share);
      if (!(right > 0)) continue;
      inliers[pair.is_one_station ? 1 : 0] += right;
      squares[pair.is_one_station ? 1 : 0] += right * pair.errors[m].px * pair.errors[m].px;
    }
  }
  result.inliers = inliers[0] + inliers[1];
  const size_t telling = inliers[1] > 0 ? 1 : 0;
  result.sigma_px = std::sqrt(squares[telling] / std::max(inliers[telling], 1e-9));
  return result;
}

struct MatchesAndErrors {
  int image1 = 0;
  int image2 = 0;
  FeatureMatches matches;
  std::vector<double> errors_px;
};

// Of all matches that may be the object's, of photos that a scene has. Between stations that a background
// places, what agrees better with cameras before which nothing turns is left out.
std::vector<MatchesAndErrors> ErrorsOfAllMatches(const ScanFeatures& features, const AlignedScene& aligned) {
  const std::vector<PosedImage> posed = PosedImages(features, aligned.scene, true);
  std::vector<PosedImage> unmoved(posed.size());
  if (!aligned.background.images.empty()) unmoved = PosedImages(features, aligned.scene, false);
  const MatchErrors against_poses(posed, AllKeypoints(features));
  const MatchErrors against_background(unmoved, AllKeypoints(features));
  const std::vector<ImagePairMatches>& all = AllPairs(features);
  std::vector<MatchesAndErrors> result(all.size());
  ParallelFor(static_cast<int64_t>(all.size()), 0, [&](int64_t p) {
    const ImagePairMatches& given = all[static_cast<size_t>(p)];
    const auto i = static_cast<size_t>(given.image1);
    const auto j = static_cast<size_t>(given.image2);
    if (!posed[i].is_posed || !posed[j].is_posed) return;
    MatchesAndErrors& of_pair = result[static_cast<size_t>(p)];
    of_pair.image1 = given.image1;
    of_pair.image2 = given.image2;
    const bool may_stand = features.images[i].station != features.images[j].station && unmoved[i].is_posed &&
                           unmoved[j].is_posed;
    const FeatureMatches possible = PossibleObjectMatches(features, given);
    const std::vector<double> errors_px = against_poses.Of(given.image1, given.image2, possible);
    std::vector<double> standing_px;
    if (may_stand) standing_px = against_background.Of(given.image1, given.image2, possible);
    for (size_t m = 0; m < possible.size(); ++m) {
      if (may_stand && standing_px[m] < errors_px[m]) continue;
      of_pair.matches.push_back(possible[m]);
      of_pair.errors_px.push_back(errors_px[m]);
    }
  });
  return result;
}

}  // namespace

MatchLikelihood LikelihoodOfMatches(const ScanFeatures& features, const AlignedScene& aligned,
                                    const std::vector<PossiblePair>& object_pairs) {
  const std::vector<PosedImage> posed = PosedImages(features, aligned.scene, true);
  const MatchErrors against_poses(posed, AllKeypoints(features));
  std::vector<std::optional<PairErrors>> of_pairs(object_pairs.size());
  ParallelFor(static_cast<int64_t>(object_pairs.size()), 0, [&](int64_t p) {
    const PossiblePair& pair = object_pairs[static_cast<size_t>(p)];
    const auto i = static_cast<size_t>(pair.image1);
    const auto j = static_cast<size_t>(pair.image2);
    if (!posed[i].is_posed || !posed[j].is_posed) return;
    PairErrors& of_pair = of_pairs[static_cast<size_t>(p)].emplace(
        PairErrors{features.images[i].station == features.images[j].station, {}});
    // A match in one station that moves farther than the table's turn can move it is wrong.
    const double turn = AngleBetween(posed[i].cam_from_body.rotation, posed[j].cam_from_body.rotation);
    const double farthest_px = pair.reach_px > 0 ? pair.reach_px * 2 * std::sin(turn / 2) : kInfinity;
    const std::vector<double> errors_px = against_poses.Of(pair.image1, pair.image2, pair.matches);
    for (size_t m = 0; m < pair.matches.size(); ++m) {
      const FeatureMatch& match = pair.matches[m];
      const Eigen::Vector2d xy1 = features.images[i].keypoints[match.point2D_idx1].cast<double>();
      const Eigen::Vector2d xy2 = features.images[j].keypoints[match.point2D_idx2].cast<double>();
      const bool may_be = (xy2 - xy1).norm() <= farthest_px;
      of_pair.errors.push_back({may_be ? errors_px[m] : kInfinity, pair.chance[m]});
    }
  });
  std::vector<PairErrors> errors;
  for (std::optional<PairErrors>& of_pair : of_pairs) {
    if (of_pair) errors.push_back(std::move(*of_pair));
  }
  MatchLikelihood result;
  if (errors.empty()) return result;
  double sigma_px = kFirstSigmaPx;
  for (int round = 0; round < kRounds; ++round) {
    result = Round(errors, sigma_px);
    const double next = std::clamp(result.sigma_px, kLeastSigmaPx, kMostSigmaPx);
    const bool is_settled = std::abs(next - sigma_px) <= 0.01 * sigma_px;
    sigma_px = next;
    if (is_settled) break;
  }
  result.sigma_px = sigma_px;
  return result;
}

ChosenMatches MatchesThatAgree(const ScanFeatures& features, const AlignedScene& aligned,
                               double max_error_px) {
  ChosenMatches agreeing;
  std::vector<double> errors_px;
  for (const MatchesAndErrors& pair : ErrorsOfAllMatches(features, aligned)) {
    errors_px.insert(errors_px.end(), pair.errors_px.begin(), pair.errors_px.end());
    ImagePairMatches of_pair{pair.image1, pair.image2, {}};
    for (size_t m = 0; m < pair.matches.size(); ++m) {
      if (pair.errors_px[m] <= max_error_px) of_pair.matches.push_back(pair.matches[m]);
    }
    if (!of_pair.matches.empty()) agreeing.pairs.push_back(std::move(of_pair));
  }
  agreeing.variance = VarianceOfChosen(errors_px, max_error_px);
  return agreeing;
}

}  // namespace s2gs
