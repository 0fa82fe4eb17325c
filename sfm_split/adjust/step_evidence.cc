#include "sfm_split/adjust/step_evidence.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <utility>

#include "sfm_split/adjust/pair_proof.h"
#include "sfm_split/adjust/track_triangulation.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/scene/axis_turn.h"
#include "sfm_split/turntable/wrong_matches.h"

namespace s2gs {
namespace {

// Turns that are tried, to either side: what is asked of a scan is a degree; far away they are as close as
// the likelihood of few matches is wide.
constexpr std::array<double, 33> kTurnsDeg = {1,  1.5, 2,  3,  4.5, 6.5, 9,  12, 15, 18, 21,
                                              24, 27,  30, 33, 36,  39,  42, 45, 48, 51, 54,
                                              57, 60,  63, 66, 69,  72,  75, 78, 81, 84, 87};
constexpr size_t kNumTurns = 2 * kTurnsDeg.size() + 1;  // in order; that of the poses in the middle
constexpr size_t kAsPosed = kTurnsDeg.size();
constexpr size_t kMaxMatches = 100;  // of a pair, evenly
constexpr int kNoiseRounds = 20;
constexpr double kFirstNoisePx = 1;
constexpr double kNoiseSettled = 0.01;
constexpr int kShareRounds = 6;
constexpr double kRootTwoPi = 2.50662827463100050;
constexpr double kUniformWidth = 3.4641;  // of a uniform distribution, over its standard deviation
constexpr double kLeastNoisePx = 0.5;     // keypoints are hardly better
constexpr double kMostNoisePx = 2;        // more is what the poses are wrong by

constexpr double kLeastAwayDeg = 5;
constexpr int kNear = 2;  // places

using Gains = std::array<double, kNumTurns>;

double TurnDeg(size_t t) {
  if (t == kAsPosed) return 0;
  return t > kAsPosed ? kTurnsDeg[t - kAsPosed - 1] : -kTurnsDeg[kAsPosed - 1 - t];
}

struct Match {
  Eigen::Vector2d xy1;
  Eigen::Vector2d xy2;
  double chance = 0;  // density of a wrong match's error [1 / px]
};

struct Pair {
  size_t image1 = 0;
  size_t image2 = 0;
  std::vector<Match> matches;
};

// Densities of errors, were the matches right, over those of wrong ones.
std::vector<double> OverChance(const Pair& pair, const PosedImage& first, const PosedImage& second,
                               double noise_px, std::vector<double>* errors) {
  std::vector<double> over;
  for (const Match& match : pair.matches) {
    const double error = MatchErrorPx(first, second, match.xy1, match.xy2);
    const double ratio = error / noise_px;
    over.push_back(std::exp(-0.5 * ratio * ratio) / (noise_px * kRootTwoPi * match.chance));
    if (errors != nullptr) errors->push_back(error);
  }
  return over;
}

// The share of right matches that fits best.
double RightShare(const std::vector<double>& over) {
  double share = 0.5;
  for (int k = 0; k < kShareRounds; ++k) {
    double sum = 1;
    for (const double o : over) sum += share * o / (share * o + 1 - share);
    share = sum / (static_cast<double>(over.size()) + 2);
  }
  return share;
}

// Log-likelihood of errors over that of all being wrong.
double Gain(const std::vector<double>& over) {
  const double share = RightShare(over);
  double gain = 0;
  for (const double o : over) gain += std::log(1 - share + share * o);
  return gain;
}

Eigen::Vector2d Move(const ScanFeatures& features, const ImagePairMatches& pair, const FeatureMatch& match) {
  return (features.images[static_cast<size_t>(pair.image2)].keypoints[match.point2D_idx2] -
          features.images[static_cast<size_t>(pair.image1)].keypoints[match.point2D_idx1])
      .cast<double>();
}

// How wrong matches of a station move: as those of its photos farthest apart do.
WrongMatches WrongMatchesOf(const ScanFeatures& features, const std::vector<int>& order) {
  std::map<int, int> place;
  for (size_t k = 0; k < order.size(); ++k) place[order[k]] = static_cast<int>(k);
  const int count = static_cast<int>(order.size());
  std::vector<std::pair<int, ImagePairMatches>> pairs;
  size_t all = 0;
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  Eigen::Vector2d squares = Eigen::Vector2d::Zero();
  for (const ImagePairMatches& given : AllPairs(features)) {
    const auto first = place.find(given.image1);
    const auto second = place.find(given.image2);
    if (first == place.end() || second == place.end()) continue;
    const int steps = std::abs(first->second - second->second);
    pairs.push_back({std::min(steps, count - steps),
                     {given.image1, given.image2, PossibleObjectMatches(features, given)}});
    for (const FeatureMatch& match : pairs.back().second.matches) {
      const Eigen::Vector2d xy =
          features.images[static_cast<size_t>(given.image1)].keypoints[match.point2D_idx1].cast<double>();
      sum += xy;
      squares += xy.cwiseAbs2();
      ++all;
    }
  }
  std::stable_sort(pairs.begin(), pairs.end(),
                   [](const auto& a, const auto& b) { return a.first > b.first; });
  std::vector<Eigen::Vector2d> moves;
  for (const auto& [steps, pair] : pairs) {
    if (static_cast<double>(moves.size()) > kFarShare * static_cast<double>(all)) break;
    for (const FeatureMatch& match : pair.matches) moves.push_back(Move(features, pair, match));
  }
  const double num = std::max<double>(1, static_cast<double>(all));
  const double extent =
      kUniformWidth * std::sqrt(std::max(1.0, (squares / num - (sum / num).cwiseAbs2()).mean()));
  return {moves, extent};
}

class Asker {
 public:
  Asker(const std::vector<const View*>& views, const std::vector<const Camera*>& cameras,
        const TurntableAxis& axis)
      : views_(views), cameras_(cameras), axis_(axis) {}

  PosedImage Posed(size_t image, double turn_deg) const {
    return {true, cameras_[image],
            views_[image]->cam_from_world * TurnAbout(axis_, turn_deg * kDegree) *
                views_[image]->world_from_object};
  }

  // The likelihoods of a pair's matches where its second photo is turned about the axis.
  Gains OfTurns(const Pair& pair, double noise_px) const {
    Gains gains{};
    const PosedImage first = Posed(pair.image1, 0);
    for (size_t t = 0; t < kNumTurns; ++t)
      gains[t] = Gain(OverChance(pair, first, Posed(pair.image2, TurnDeg(t)), noise_px, nullptr));
    return gains;
  }

  // Standard deviation of the right matches' errors at the poses, by expectation and maximisation.
  double Noise(const std::vector<Pair>& pairs) const {
    double noise = kFirstNoisePx;
    for (int round = 0; round < kNoiseRounds; ++round) {
      double squares = 0;
      double sum = 0;
      for (const Pair& pair : pairs) {
        std::vector<double> errors;
        const std::vector<double> over =
            OverChance(pair, Posed(pair.image1, 0), Posed(pair.image2, 0), noise, &errors);
        const double share = RightShare(over);
        for (size_t m = 0; m < over.size(); ++m) {
          const double right = share * over[m] / (share * over[m] + 1 - share);
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

 private:
  const std::vector<const View*>& views_;
  const std::vector<const Camera*>& cameras_;
  const TurntableAxis& axis_;
};

// The pairs of a station whose photos are near each other by name or by their places.
std::vector<Pair> NearPairs(const ScanFeatures& features, const std::vector<int>& by_name,
                            const std::vector<int>& by_angle,
                            const std::set<std::pair<int, uint32_t>>& others, const WrongMatches& wrong) {
  const int count = static_cast<int>(by_name.size());
  std::array<std::map<int, int>, 2> places;
  for (int k = 0; k < count; ++k) {
    places[0][by_name[static_cast<size_t>(k)]] = k;
    places[1][by_angle[static_cast<size_t>(k)]] = k;
  }
  std::vector<Pair> pairs;
  for (const ImagePairMatches& given : AllPairs(features)) {
    if (places[0].count(given.image1) == 0 || places[0].count(given.image2) == 0) continue;
    const bool are_near = std::any_of(places.begin(), places.end(), [&](std::map<int, int>& place) {
      const int apart = std::abs(place[given.image1] - place[given.image2]);
      return std::min(apart, count - apart) <= kNear;
    });
    if (!are_near) continue;
    ImagePairMatches own = {given.image1, given.image2, {}};
    for (const FeatureMatch& match : PossibleObjectMatches(features, given)) {
      if (others.count({given.image1, match.point2D_idx1}) == 0 &&
          others.count({given.image2, match.point2D_idx2}) == 0)
        own.matches.push_back(match);
    }
    pairs.push_back({static_cast<size_t>(given.image1), static_cast<size_t>(given.image2), {}});
    const Keypoints& keypoints1 = features.images[pairs.back().image1].keypoints;
    const Keypoints& keypoints2 = features.images[pairs.back().image2].keypoints;
    const std::vector<int> details = DistinctDetails(keypoints1, keypoints2, own.matches);
    const size_t stride = 1 + details.size() / (kMaxMatches + 1);
    for (size_t d = 0; d < details.size(); d += stride) {
      const FeatureMatch& match = own.matches[static_cast<size_t>(details[d])];
      pairs.back().matches.push_back({keypoints1[match.point2D_idx1].cast<double>(),
                                      keypoints2[match.point2D_idx2].cast<double>(),
                                      wrong.Chance(Move(features, own, match))});
    }
  }
  return pairs;
}

double AngleBetweenDeg(const View& a, const View& b) {
  return std::abs(WrapAngle((b.angle_deg - a.angle_deg) * kDegree)) / kDegree;
}

}  // namespace

StepEvidence AskSteps(const ScanFeatures& features, const std::vector<const Camera*>& cameras,
                      const std::vector<const View*>& views, const TurntableAxis& axis,
                      const std::set<std::pair<int, uint32_t>>& others, double risk) {
  StepEvidence evidence;
  std::map<int, std::vector<int>> stations;
  for (size_t i = 0; i < views.size(); ++i) {
    if (views[i] != nullptr) stations[features.images[i].station].push_back(static_cast<int>(i));
  }
  const Asker asker(views, cameras, axis);
  // Each photo, alone and with those that follow, at each turn.
  const double least = std::log(2.0 * static_cast<double>(views.size() * (kNumTurns - 1)) / risk);
  for (const auto& [station, by_name] : stations) {
    const size_t count = by_name.size();
    if (count < 2) continue;
    std::vector<int> order = by_name;
    std::stable_sort(order.begin(), order.end(), [&](int a, int b) {
      return views[static_cast<size_t>(a)]->angle_deg < views[static_cast<size_t>(b)]->angle_deg;
    });
    std::map<int, size_t> place;
    for (size_t k = 0; k < count; ++k) place[order[k]] = k;
    const std::vector<Pair> pairs =
        NearPairs(features, by_name, order, others, WrongMatchesOf(features, by_name));
    const double noise = asker.Noise(pairs);
    std::vector<Gains> of_photo(count, Gains{});    // it alone is turned
    std::vector<Gains> from_photo(count, Gains{});  // it and those after it, as far as pairs reach
    for (const Pair& pair : pairs) {
      const Gains gains = asker.OfTurns(pair, noise);
      const size_t p1 = place[static_cast<int>(pair.image1)];
      const size_t p2 = place[static_cast<int>(pair.image2)];
      // Across the end of the turn the photos after it are the first ones.
      const bool is_across = 2 * (p1 > p2 ? p1 - p2 : p2 - p1) > count;
      const bool is_forward = (p1 < p2) != is_across;
      const size_t before = is_forward ? p1 : p2;
      const size_t after = is_forward ? p2 : p1;
      for (size_t t = 0; t < kNumTurns; ++t) {
        const double gain = gains[is_forward ? t : kNumTurns - 1 - t] - gains[kAsPosed];
        of_photo[after][t] += gain;
        of_photo[before][kNumTurns - 1 - t] += gain;
        for (size_t k = before; k != after;) {
          k = (k + 1) % count;
          from_photo[k][t] += gain;
        }
      }
    }

    std::vector<double> steps;
    for (size_t k = 0; k + 1 < count; ++k)
      steps.push_back(
          AngleBetweenDeg(*views[static_cast<size_t>(order[k])], *views[static_cast<size_t>(order[k + 1])]));
    const double away_deg = std::max(kLeastAwayDeg, UpperMedian(steps) / 2);
    for (size_t k = 0; k < count; ++k) {
      MisturnedPhoto worst;
      bool is_told = true;
      for (size_t t = 0; t < kNumTurns; ++t) {
        is_told &= std::abs(TurnDeg(t)) < away_deg || of_photo[k][t] <= std::log(risk);
        for (const bool are_all : {false, true}) {
          const double gain = (are_all ? from_photo : of_photo)[k][t];
          if (gain > std::max(least, worst.log_ratio)) worst = {order[k], are_all, TurnDeg(t), gain};
        }
      }
      if (worst.log_ratio > 0) evidence.misturned.push_back(worst);
      if (!is_told) evidence.untold.push_back(order[k]);
    }
  }
  return evidence;
}

}  // namespace s2gs
