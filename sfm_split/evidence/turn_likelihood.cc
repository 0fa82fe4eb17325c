#include "sfm_split/evidence/turn_likelihood.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/circular_motion/match_mixture.h"
#include "sfm_split/circular_motion/possible_matches.h"
#include "sfm_split/circular_motion/wrong_matches.h"
#include "sfm_split/evidence/pair_proof.h"
#include "sfm_split/scene/axis_turn.h"

namespace s2gs {
namespace {

constexpr size_t kMaxMatches = 100;  // of a pair, evenly
constexpr int kNoiseRounds = 20;     // of noise and angle by turns, at most
// That noise and angle by turns begin with: keypoints', as detectors place them [px].
constexpr double kFirstNoisePx = 1;
constexpr double kNoiseSettled = 0.01;
constexpr double kLeastNoisePx = 0.5;  // keypoints are hardly better
constexpr double kMostNoisePx = 2;     // more is what the poses are wrong by
constexpr int kNear = 2;               // places

// Densities of errors, were the matches right, over those of wrong ones.
std::vector<double> OverChance(const TurnPair& pair, const PosedImage& first, const PosedImage& second,
                               double noise_px, std::vector<double>* errors) {
  std::vector<double> over;
  for (const TurnPair::Match& match : pair.matches) {
    const double error = MatchErrorPx(first, second, match.xy1, match.xy2);
    const double ratio = error / noise_px;
    over.push_back(std::exp(-0.5 * ratio * ratio) / (noise_px * kRootTwoPi * match.chance));
    if (errors != nullptr) errors->push_back(error);
  }
  return over;
}

// Where a station's photos stand on the table's circle: by their views, or by their places in a closed turn.
class Circle {
 public:
  Circle(const std::vector<const View*>& views, const std::vector<int>& station) {
    for (const int image : station)
      angle_rad_[image] = views[static_cast<size_t>(image)]->angle_deg * kDegree;
  }
  explicit Circle(const std::vector<int>& by_name) {
    for (size_t k = 0; k < by_name.size(); ++k)
      angle_rad_[by_name[k]] = 2 * kPi * static_cast<double>(k) / static_cast<double>(by_name.size());
  }

  MatchMove Move(const ScanFeatures& features, const ImagePairMatches& pair,
                 const FeatureMatch& match) const {
    return MoveOf(features, pair.image1, pair.image2, match,
                  TurnBetween(angle_rad_.at(pair.image1), angle_rad_.at(pair.image2)));
  }

 private:
  std::map<int, double> angle_rad_;
};

// Those that may be the object's, without `others`.
FeatureMatches OwnMatches(const ScanFeatures& features, const ImagePairMatches& given,
                          const std::set<std::pair<int, uint32_t>>& others) {
  FeatureMatches own;
  for (const FeatureMatch& match : PossibleObjectMatches(features, given)) {
    if (others.count({given.image1, match.point2D_idx1}) == 0 &&
        others.count({given.image2, match.point2D_idx2}) == 0)
      own.push_back(match);
  }
  return own;
}

// How wrong matches of a station move: as those of its photos farthest apart do.
WrongMatches WrongMatchesOf(const ScanFeatures& features, const std::vector<int>& order,
                            const Circle& circle) {
  std::map<int, int> place;
  for (size_t k = 0; k < order.size(); ++k) place[order[k]] = static_cast<int>(k);
  const int count = static_cast<int>(order.size());
  std::vector<std::pair<int, ImagePairMatches>> pairs;
  size_t all = 0;
  KeypointExtent extent;
  for (const ImagePairMatches& given : AllPairs(features)) {
    const auto first = place.find(given.image1);
    const auto second = place.find(given.image2);
    if (first == place.end() || second == place.end()) continue;
    const int steps = std::abs(first->second - second->second);
    pairs.push_back({std::min(steps, count - steps),
                     {given.image1, given.image2, PossibleObjectMatches(features, given)}});
    for (const FeatureMatch& match : pairs.back().second.matches) {
      extent.Add(
          features.images[static_cast<size_t>(given.image1)].keypoints[match.point2D_idx1].cast<double>());
      ++all;
    }
  }
  std::stable_sort(pairs.begin(), pairs.end(),
                   [](const auto& a, const auto& b) { return a.first > b.first; });
  std::vector<MatchMove> moves;
  for (const auto& [steps, pair] : pairs) {
    if (static_cast<double>(moves.size()) > kFarShare * static_cast<double>(all)) break;
    for (const FeatureMatch& match : pair.matches) moves.push_back(circle.Move(features, pair, match));
  }
  return {moves, extent.Px()};
}

}  // namespace

std::vector<TurnPair> NearPairs(const ScanFeatures& features, const std::vector<const View*>& views,
                                const std::vector<int>& by_name, const std::vector<int>& by_angle,
                                const std::set<std::pair<int, uint32_t>>& others) {
  // An arc's photos close no turn, and angles may be wrong.
  const Circle by_views(views, by_name);
  const Circle closed(by_name);
  const WrongMatches wrong_by_views = WrongMatchesOf(features, by_name, by_views);
  const WrongMatches wrong_closed = WrongMatchesOf(features, by_name, closed);
  const bool is_by_views = wrong_by_views.OrbitGain() >= wrong_closed.OrbitGain();
  const Circle& circle = is_by_views ? by_views : closed;
  const WrongMatches& wrong = is_by_views ? wrong_by_views : wrong_closed;
  const int count = static_cast<int>(by_name.size());
  std::array<std::map<int, int>, 2> places;
  for (int k = 0; k < count; ++k) {
    places[0][by_name[static_cast<size_t>(k)]] = k;
    places[1][by_angle[static_cast<size_t>(k)]] = k;
  }
  std::vector<TurnPair> pairs;
  std::vector<std::vector<MatchMove>> moves;  // of the pairs' matches
  for (const ImagePairMatches& given : AllPairs(features)) {
    if (places[0].count(given.image1) == 0 || places[0].count(given.image2) == 0) continue;
    const bool are_near = std::any_of(places.begin(), places.end(), [&](std::map<int, int>& place) {
      const int apart = std::abs(place[given.image1] - place[given.image2]);
      return std::min(apart, count - apart) <= kNear;
    });
    if (!are_near) continue;
    const ImagePairMatches own = {given.image1, given.image2, OwnMatches(features, given, others)};
    pairs.push_back({static_cast<size_t>(given.image1), static_cast<size_t>(given.image2), {}});
    const Keypoints& keypoints1 = features.images[pairs.back().image1].keypoints;
    const Keypoints& keypoints2 = features.images[pairs.back().image2].keypoints;
    const std::vector<int> details = DistinctDetails(keypoints1, keypoints2, own.matches);
    const size_t stride = 1 + details.size() / (kMaxMatches + 1);
    moves.emplace_back();
    for (size_t d = 0; d < details.size(); d += stride) {
      const FeatureMatch& match = own.matches[static_cast<size_t>(details[d])];
      pairs.back().matches.push_back(
          {keypoints1[match.point2D_idx1].cast<double>(), keypoints2[match.point2D_idx2].cast<double>(), 0});
      moves.back().push_back(circle.Move(features, own, match));
    }
  }
  ParallelFor(static_cast<int64_t>(pairs.size()), 0, [&](int64_t p) {
    const auto at = static_cast<size_t>(p);
    for (size_t m = 0; m < moves[at].size(); ++m) pairs[at].matches[m].chance = wrong.Chance(moves[at][m]);
  });
  return pairs;
}

PosedImage TurnLikelihood::Posed(size_t image, double turn_deg) const {
  return {true, cameras_[image],
          views_[image]->cam_from_world * TurnAbout(axis_, turn_deg * kDegree) *
              views_[image]->world_from_object};
}

std::vector<double> TurnLikelihood::OfTurns(const TurnPair& pair, const std::vector<double>& turns_deg,
                                            double noise_px) const {
  std::vector<double> gains;
  gains.reserve(turns_deg.size());
  const PosedImage first = Posed(pair.image1, 0);
  for (const double turn_deg : turns_deg) {
    const std::vector<double> over = OverChance(pair, first, Posed(pair.image2, turn_deg), noise_px, nullptr);
    gains.push_back(MixtureGain(over, RightShare(over)));
  }
  return gains;
}

double TurnLikelihood::Noise(const std::vector<TurnPair>& pairs) const {
  double noise = kFirstNoisePx;
  for (int round = 0; round < kNoiseRounds; ++round) {
    double squares = 0;
    double sum = 0;
    for (const TurnPair& pair : pairs) {
      std::vector<double> errors;
      const std::vector<double> over =
          OverChance(pair, Posed(pair.image1, 0), Posed(pair.image2, 0), noise, &errors);
      const double share = RightShare(over);
      for (size_t m = 0; m < over.size(); ++m) {
        const double right = RightProbability(over[m], share);
        if (!(right > 0)) continue;
        sum += right;
        squares += right * errors[m] * errors[m];
      }
    }
    const double before = noise;
    noise = std::clamp(std::sqrt(squares / std::max(sum, 1e-9)), kLeastNoisePx, kMostNoisePx);
    if (std::abs(noise - before) <= kNoiseSettled * before) break;
  }
  return noise;
}

}  // namespace s2gs
