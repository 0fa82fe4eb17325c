#include "sfm_split/evidence/step_evidence.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <utility>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/infinity.h"
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

constexpr double kCertain = 8;  // e^8 to one
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

// What the pairs of a station say of each of its photos, in order of angle around the table, at each turn.
class StationCircle {
 public:
  StationCircle(const std::vector<TurnPair>& pairs, const std::vector<const View*>& views,
                const std::vector<int>& order, const TurnLikelihood& likelihood, double noise_px);

  // Of a photo that is turned alone, in order.
  const Gains& OfPhoto(size_t k) const { return of_photo_[k]; }
  // Of all photos from one on that are turned, by t. Angles around a table make one turn: what this step
  // gains is lost at another one, or at all of them by their share.
  double FromPhoto(size_t k, size_t t) const;
  // What pairs that go over the step say of it alone, whatever that costs at other steps: whether it is worth
  // asking FromPhoto.
  double OfStep(size_t k, size_t t) const { return of_step_[k][t]; }
  double MedianStepDeg() const;

 private:
  // A pair and the steps between its photos, by the place of the later photo of each.
  struct Spanned {
    bool is_forward = true;  // the second photo is the later one
    std::vector<size_t> steps;
  };

  Spanned Between(size_t p1, size_t p2) const;
  void AddGains(size_t p, const std::vector<double>& gains);
  double TurnedAtAnother(size_t k, size_t t) const;
  double TurnedAtAll(size_t k, size_t t) const;

  const std::vector<TurnPair>& pairs_;
  const TurnLikelihood& likelihood_;
  const double noise_px_;
  std::vector<double> steps_deg_;  // to each photo, from the one before; to the first from the last
  std::vector<Spanned> spanned_;   // per pair
  std::vector<double> as_posed_;   // per pair
  std::vector<Gains> of_photo_;
  std::vector<Gains> of_step_;
};

StationCircle::StationCircle(const std::vector<TurnPair>& pairs, const std::vector<const View*>& views,
                             const std::vector<int>& order, const TurnLikelihood& likelihood, double noise_px)
    : pairs_(pairs),
      likelihood_(likelihood),
      noise_px_(noise_px),
      spanned_(pairs.size()),
      as_posed_(pairs.size()),
      of_photo_(order.size(), Gains{}),
      of_step_(order.size(), Gains{}) {
  const size_t count = order.size();
  std::map<int, size_t> place;
  for (size_t k = 0; k < count; ++k) {
    place[order[k]] = k;
    const View& here = *views[static_cast<size_t>(order[k])];
    const View& before = *views[static_cast<size_t>(order[k > 0 ? k - 1 : count - 1])];
    steps_deg_.push_back(here.angle_deg - before.angle_deg + (k > 0 ? 0 : 360));
  }
  for (size_t p = 0; p < pairs.size(); ++p) {
    spanned_[p] =
        Between(place.at(static_cast<int>(pairs[p].image1)), place.at(static_cast<int>(pairs[p].image2)));
  }
  std::vector<std::vector<double>> gains_of_pair(pairs.size());
  const std::vector<double> turns = TurnsDeg();
  ParallelFor(static_cast<int64_t>(pairs.size()), 0, [&](int64_t p) {
    gains_of_pair[static_cast<size_t>(p)] =
        likelihood.OfTurns(pairs[static_cast<size_t>(p)], turns, noise_px);
  });
  for (size_t p = 0; p < pairs.size(); ++p) AddGains(p, gains_of_pair[p]);
}

// Of two photos, by their places: the steps from the earlier one to the later one.
StationCircle::Spanned StationCircle::Between(size_t p1, size_t p2) const {
  const size_t count = steps_deg_.size();
  // Across the end of the turn the photos after it are the first ones.
  const bool is_across = 2 * (p1 > p2 ? p1 - p2 : p2 - p1) > count;
  Spanned spanned{(p1 < p2) != is_across, {}};
  const size_t after = spanned.is_forward ? p2 : p1;
  for (size_t k = spanned.is_forward ? p1 : p2; k != after;) {
    k = (k + 1) % count;
    spanned.steps.push_back(k);
  }
  return spanned;
}

// Of a pair, at each turn of its second photo.
void StationCircle::AddGains(size_t p, const std::vector<double>& gains) {
  as_posed_[p] = gains[kAsPosed];
  const std::vector<size_t>& steps = spanned_[p].steps;
  const size_t after = steps.back();
  const size_t before = (steps.front() > 0 ? steps.front() : steps_deg_.size()) - 1;
  for (size_t t = 0; t < kNumTurns; ++t) {
    const double gain = gains[spanned_[p].is_forward ? t : kNumTurns - 1 - t] - as_posed_[p];
    of_photo_[after][t] += gain;
    of_photo_[before][kNumTurns - 1 - t] += gain;
    for (const size_t k : steps) of_step_[k][t] += gain;
  }
}

// Steps over which one pair goes are not told apart by it, and so are not asked.
double StationCircle::TurnedAtAnother(size_t k, size_t t) const {
  std::vector<bool> is_apart(of_step_.size(), true);
  for (const Spanned& spanned : spanned_) {
    if (std::find(spanned.steps.begin(), spanned.steps.end(), k) == spanned.steps.end()) continue;
    for (const size_t step : spanned.steps) is_apart[step] = false;
  }
  is_apart[k] = false;
  double most = -kInfinity;
  for (size_t j = 0; j < of_step_.size(); ++j) {
    if (is_apart[j]) most = std::max(most, of_step_[j][kNumTurns - 1 - t]);
  }
  return of_step_[k][t] + most;
}

// As where steps were taken too long, and the turn for more than one.
double StationCircle::TurnedAtAll(size_t k, size_t t) const {
  const double others_deg = 360 - steps_deg_[k];
  if (!(others_deg > 0)) return -kInfinity;
  double gain = 0;
  for (size_t p = 0; p < pairs_.size(); ++p) {
    double turn_deg = 0;
    for (const size_t step : spanned_[p].steps)
      turn_deg += TurnDeg(t) * (step == k ? 1 : -steps_deg_[step] / others_deg);
    if (!spanned_[p].is_forward) turn_deg = -turn_deg;
    gain += likelihood_.OfTurns(pairs_[p], {turn_deg}, noise_px_)[0] - as_posed_[p];
  }
  return gain;
}

double StationCircle::FromPhoto(size_t k, size_t t) const {
  return std::max(TurnedAtAnother(k, t), TurnedAtAll(k, t));
}

double StationCircle::MedianStepDeg() const {
  return UpperMedian(std::vector<double>(steps_deg_.begin() + 1, steps_deg_.end()));
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
    const StationCircle circle(pairs, views, order, likelihood, noise);
    const double away_deg = std::max(kLeastAwayDeg, circle.MedianStepDeg() / 2);
    for (size_t k = 0; k < count; ++k) {
      MisturnedPhoto worst;
      bool is_told = true;
      const auto compare = [&](size_t t, bool are_all, double gain) {
        if (gain > std::max(least, worst.log_ratio)) worst = {order[k], are_all, TurnDeg(t), gain};
      };
      for (size_t t = 0; t < kNumTurns; ++t) {
        const double alone = circle.OfPhoto(k)[t];
        is_told &= std::abs(TurnDeg(t)) < away_deg || alone <= overdispersion * std::log(risk);
        compare(t, false, alone);
        if (circle.OfStep(k, t) > least) compare(t, true, circle.FromPhoto(k, t));
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
