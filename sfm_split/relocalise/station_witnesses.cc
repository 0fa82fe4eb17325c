#include "sfm_split/relocalise/station_witnesses.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include "sfm_split/adjust/match_errors.h"
#include "sfm_split/adjust/posed_images.h"
#include "sfm_split/base/infinity.h"
#include "sfm_split/base/union_find.h"
#include "sfm_split/circular_motion/match_mixture.h"
#include "sfm_split/scene/keypoint_numbers.h"

namespace s2gs {
namespace {

constexpr double kAgreeingPx = 1.5;  // five times what keypoints are good to
constexpr int kRounds = 60;          // of expectation and maximisation

// A match between stations, with its errors if it is the object's and if it stands still.
struct Between {
  PossiblePair* pair = nullptr;
  size_t match = 0;
  std::pair<uint32_t, uint32_t> details;  // of the two stations
  double object_px = 0;
  double standing_px = 0;
  double even = 0;  // density of an error anywhere
};

double Normal(double error_px, double sigma_px) {
  const double ratio = error_px / sigma_px;
  return std::exp(-0.5 * ratio * ratio) / (sigma_px * kRootTwoPi);
}

// Three kinds of matches: the object's, what stands still, and anything.
struct Kinds {
  double object_share = 0.3;
  double standing_share = 0.1;
  double object_px = 0.5;
  double standing_px = 1;

  double Object(const Between& match) const { return object_share * Normal(match.object_px, object_px); }
  double Standing(const Between& match) const {
    return standing_share * Normal(match.standing_px, standing_px);
  }
  double Anything(const Between& match) const { return (1 - object_share - standing_share) * match.even; }
};

// By expectation and maximisation; as if one match more were of each kind.
Kinds FitKinds(const std::vector<Between>& matches) {
  Kinds kinds;
  for (int round = 0; round < kRounds; ++round) {
    double object = 1;
    double standing = 1;
    double anything = 1;
    double object_squares = kinds.object_px * kinds.object_px;
    double standing_squares = kinds.standing_px * kinds.standing_px;
    for (const Between& match : matches) {
      const double all = kinds.Object(match) + kinds.Standing(match) + kinds.Anything(match);
      const double is_object = kinds.Object(match) / all;
      const double is_standing = kinds.Standing(match) / all;
      object += is_object;
      standing += is_standing;
      anything += 1 - is_object - is_standing;
      if (is_object > 0) object_squares += is_object * match.object_px * match.object_px;
      if (is_standing > 0) standing_squares += is_standing * match.standing_px * match.standing_px;
    }
    const double sum = object + standing + anything;
    kinds.object_share = object / sum;
    kinds.standing_share = standing / sum;
    kinds.object_px = std::clamp(std::sqrt(object_squares / object), kLeastSigmaPx, kMostSigmaPx);
    kinds.standing_px = std::clamp(std::sqrt(standing_squares / standing), kLeastSigmaPx, kMostSigmaPx);
  }
  return kinds;
}

}  // namespace

std::vector<PossiblePair> StationWitnesses(const ScanFeatures& features, const AlignedScene& aligned,
                                           const std::vector<PossiblePair>& object_pairs) {
  std::vector<PossiblePair> pairs = object_pairs;
  const std::vector<PosedImage> posed = PosedImages(features, aligned.scene, true);
  const std::vector<PosedImage> standing = PosedImages(features, aligned.scene, false);
  // Without a background nobody knows how cameras of two stations stand.
  const bool may_stand = !aligned.background.images.empty();
  const MatchErrors against_poses(posed, AllKeypoints(features));
  const MatchErrors against_standing(standing, AllKeypoints(features));
  KeypointNumbers numbers;
  for (const ScanImage& image : features.images) numbers.Add(image.keypoints.size());
  UnionFind details(numbers.Count());
  std::vector<Between> between;
  for (PossiblePair& pair : pairs) {
    const auto i = static_cast<size_t>(pair.image1);
    const auto j = static_cast<size_t>(pair.image2);
    if (!posed[i].is_posed || !posed[j].is_posed) continue;
    const bool is_one_station = features.images[i].station == features.images[j].station;
    const std::vector<double> errors_px = against_poses.Of(pair.image1, pair.image2, pair.matches);
    std::vector<double> standing_px(pair.matches.size(), kInfinity);
    if (!is_one_station && may_stand)
      standing_px = against_standing.Of(pair.image1, pair.image2, pair.matches);
    for (size_t m = 0; m < pair.matches.size(); ++m) {
      const FeatureMatch& match = pair.matches[m];
      if (is_one_station && !(errors_px[m] <= kAgreeingPx)) continue;
      const uint32_t one = numbers.Of(pair.image1, match.point2D_idx1);
      const uint32_t two = numbers.Of(pair.image2, match.point2D_idx2);
      if (is_one_station) {
        details.Join(one, two);
        continue;
      }
      between.push_back({&pair, m, {one, two}, errors_px[m], standing_px[m], pair.chance[m]});
    }
  }
  const Kinds kinds = FitKinds(between);
  std::map<std::pair<uint32_t, uint32_t>, double> matches_of;
  for (Between& match : between) {
    match.details = std::minmax(details.Root(match.details.first), details.Root(match.details.second));
    matches_of[match.details] += 1;
  }
  const double of_wrong = kinds.standing_share / (1 - kinds.object_share);
  for (const Between& match : between) {
    PossiblePair& pair = *match.pair;
    pair.weight.resize(pair.matches.size(), 1);
    pair.weight[match.match] = 1 / matches_of[match.details];
    pair.chance[match.match] =
        (1 - of_wrong) * match.even + of_wrong * Normal(match.standing_px, kinds.standing_px);
  }
  return pairs;
}

}  // namespace s2gs
