#include "sfm_split/evidence/step_evidence.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <utility>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/evidence/turn_likelihood.h"

namespace s2gs {
namespace {

// Turns that are tried, to either side: what is asked of a scan is a degree; far away they are as close as
// the likelihood of few matches is wide.
constexpr std::array<double, 33> kTurnsDeg = {1,  1.5, 2,  3,  4.5, 6.5, 9,  12, 15, 18, 21,
                                              24, 27,  30, 33, 36,  39,  42, 45, 48, 51, 54,
                                              57, 60,  63, 66, 69,  72,  75, 78, 81, 84, 87};
constexpr size_t kNumTurns = 2 * kTurnsDeg.size() + 1;  // in order; that of the poses in the middle
constexpr size_t kAsPosed = kTurnsDeg.size();           // place of no turn

constexpr double kLeastAwayDeg = 5;  // a turn by less is no other place of the photo
constexpr double kCertain = 8;       // e^8 to one
// Of the table's turn from photo to photo: the other way, none, twice as far.
constexpr std::array<double, 3> kOtherTurns = {-1, 0, 2};
constexpr size_t kLeastOfStation = 4;  // photos that are a turn
constexpr double kAnywhere = 0.1;      // of photos in steps, whose matches may put them anywhere

using Gains = std::array<double, kNumTurns>;

double TurnDeg(size_t t) {
  if (t == kAsPosed) return 0;
  return t > kAsPosed ? kTurnsDeg[t - kAsPosed - 1] : -kTurnsDeg[kAsPosed - 1 - t];
}

// In order; that of the poses in the middle.
std::vector<double> TurnsDeg() {
  std::vector<double> turns;
  turns.reserve(kNumTurns);
  for (size_t t = 0; t < kNumTurns; ++t) turns.push_back(TurnDeg(t));
  return turns;
}

double AngleBetweenDeg(const View& a, const View& b) {
  return std::abs(WrapAngle((b.angle_deg - a.angle_deg) * kDegree)) / kDegree;
}

// How much likelier than by the poses the matches are if the table turned in one of the other ways.
double GainOfOtherTurns(const std::vector<TurnPair>& pairs, const std::vector<const View*>& views,
                        const TurnLikelihood& likelihood, double noise_px) {
  std::array<double, kOtherTurns.size()> gains{};
  for (const TurnPair& pair : pairs) {
    const double turned =
        WrapAngle((views[pair.image2]->angle_deg - views[pair.image1]->angle_deg) * kDegree) / kDegree;
    std::vector<double> turns = {0};
    for (const double other : kOtherTurns) turns.push_back((other - 1) * turned);
    const std::vector<double> of_pair = likelihood.OfTurns(pair, turns, noise_px);
    for (size_t k = 0; k < gains.size(); ++k) gains[k] += of_pair[k + 1] - of_pair[0];
  }
  return *std::max_element(gains.begin(), gains.end());
}

// What the pairs of a station say of each of its photos, in order, at each turn.
struct StationGains {
  std::vector<Gains> of_photo;    // it alone is turned
  std::vector<Gains> from_photo;  // it and those after it, as far as pairs reach
};

StationGains GainsOf(const std::vector<TurnPair>& pairs,
                     const std::vector<std::vector<double>>& gains_of_pair, const std::vector<int>& order) {
  const size_t count = order.size();
  std::map<int, size_t> place;
  for (size_t k = 0; k < count; ++k) place[order[k]] = k;
  StationGains gains_of = {std::vector<Gains>(count, Gains{}), std::vector<Gains>(count, Gains{})};
  for (size_t p = 0; p < pairs.size(); ++p) {
    const TurnPair& pair = pairs[p];
    const std::vector<double>& gains = gains_of_pair[p];
    const size_t p1 = place.at(static_cast<int>(pair.image1));
    const size_t p2 = place.at(static_cast<int>(pair.image2));
    // Across the end of the turn the photos after it are the first ones.
    const bool is_across = 2 * (p1 > p2 ? p1 - p2 : p2 - p1) > count;
    const bool is_forward = (p1 < p2) != is_across;
    const size_t before = is_forward ? p1 : p2;
    const size_t after = is_forward ? p2 : p1;
    for (size_t t = 0; t < kNumTurns; ++t) {
      const double gain = gains[is_forward ? t : kNumTurns - 1 - t] - gains[kAsPosed];
      gains_of.of_photo[after][t] += gain;
      gains_of.of_photo[before][kNumTurns - 1 - t] += gain;
      for (size_t k = before; k != after;) {
        k = (k + 1) % count;
        gains_of.from_photo[k][t] += gain;
      }
    }
  }
  return gains_of;
}

}  // namespace

StepEvidence AskSteps(const ScanFeatures& features, const std::vector<const Camera*>& cameras,
                      const std::vector<const View*>& views, const TurntableAxis& axis,
                      const std::set<std::pair<int, uint32_t>>& others, const std::vector<bool>& is_in_steps,
                      double overdispersion, double risk) {
  StepEvidence evidence;
  std::map<int, std::vector<int>> stations;
  for (size_t i = 0; i < views.size(); ++i) {
    if (views[i] != nullptr) stations[features.images[i].station].push_back(static_cast<int>(i));
  }
  const TurnLikelihood likelihood(cameras, views, axis);
  const std::vector<double> turns = TurnsDeg();
  // Each photo, alone and with those that follow, at each turn.
  const double least =
      overdispersion * std::log(2.0 * static_cast<double>(views.size() * (kNumTurns - 1)) / risk);
  std::vector<MisturnedPhoto> misturned_in_steps;
  for (const auto& [station, by_name] : stations) {
    const size_t count = by_name.size();
    if (count < 2) continue;
    std::vector<int> order = by_name;
    std::stable_sort(order.begin(), order.end(), [&](int a, int b) {
      return views[static_cast<size_t>(a)]->angle_deg < views[static_cast<size_t>(b)]->angle_deg;
    });
    const std::vector<TurnPair> pairs = NearPairs(features, views, by_name, order, others);
    const double noise = likelihood.Noise(pairs);
    if (count >= kLeastOfStation &&
        GainOfOtherTurns(pairs, views, likelihood, noise) > -kCertain * overdispersion)
      evidence.untold_stations.push_back(by_name[0]);
    std::vector<std::vector<double>> gains_of_pair(pairs.size());
    ParallelFor(static_cast<int64_t>(pairs.size()), 0, [&](int64_t p) {
      gains_of_pair[static_cast<size_t>(p)] = likelihood.OfTurns(pairs[static_cast<size_t>(p)], turns, noise);
    });
    const auto [of_photo, from_photo] = GainsOf(pairs, gains_of_pair, order);

    std::vector<double> steps;
    for (size_t k = 0; k + 1 < count; ++k)
      steps.push_back(
          AngleBetweenDeg(*views[static_cast<size_t>(order[k])], *views[static_cast<size_t>(order[k + 1])]));
    const double away_deg = std::max(kLeastAwayDeg, UpperMedian(steps) / 2);
    for (size_t k = 0; k < count; ++k) {
      MisturnedPhoto worst;
      bool is_told = true;
      for (size_t t = 0; t < kNumTurns; ++t) {
        is_told &= std::abs(TurnDeg(t)) < away_deg || of_photo[k][t] <= overdispersion * std::log(risk);
        for (const bool are_all : {false, true}) {
          const double gain = (are_all ? from_photo : of_photo)[k][t];
          if (gain > std::max(least, worst.log_ratio)) worst = {order[k], are_all, TurnDeg(t), gain};
        }
      }
      const bool in_steps = is_in_steps[static_cast<size_t>(order[k])];
      if (worst.log_ratio > 0) (in_steps ? misturned_in_steps : evidence.misturned).push_back(worst);
      if (!is_told && !in_steps) evidence.untold.push_back(order[k]);
    }
  }
  // Steps that nine photos in ten bear out outweigh what shines or walks by in the tenth.
  const auto num_in_steps = std::count(is_in_steps.begin(), is_in_steps.end(), true);
  if (static_cast<double>(misturned_in_steps.size()) > kAnywhere * static_cast<double>(num_in_steps)) {
    evidence.misturned.insert(evidence.misturned.end(), misturned_in_steps.begin(), misturned_in_steps.end());
  }
  return evidence;
}

}  // namespace s2gs
