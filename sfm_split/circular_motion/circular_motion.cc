#include "sfm_split/circular_motion/circular_motion.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <optional>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/number_text.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/circular_motion/circular_likelihood.h"
#include "sfm_split/circular_motion/lens_priors.h"
#include "sfm_split/circular_motion/match_mixture.h"
#include "sfm_split/circular_motion/station_matches.h"
#include "sfm_split/circular_motion/station_search.h"

namespace s2gs {
namespace {

constexpr size_t kMaxLenses = 8;  // that all stations together start from

using Start = CircularStart;

class Fitter {
 public:
  Fitter(const std::vector<CircularStation>& stations, const std::vector<Camera>& cameras,
         const std::vector<FocalPrior>& priors, const CircularOptions& options, Reporter& reporter)
      : stations_(stations),
        cameras_(cameras),
        priors_(priors),
        options_(options),
        reporter_(reporter),
        rng_(options.random_seed) {}

  CircularMotion Fit();

 private:
  void CollectMatches();
  void SearchStations();
  struct Together {
    Start best;
    std::optional<Start> rival;  // that matches do not tell from it
    double closed_log_posterior = 0;
    double open_log_posterior = 0;
  };
  Together BestTogether();
  bool PutsPhotosElsewhere(const Start& a, const Start& b) const;
  CircularMotion Nothing() const;
  CircularMotion Conclude(Start best);
  Start RefineAll(const std::vector<const Start*>& starts) const;
  CircularState BestLenses(const std::vector<const Start*>& starts, CircularSteps steps) const;
  void FreeSteps(Start* all) const;
  bool FreeDistortion(Start* best, CircularPriors* priors) const;
  CircularPriors AllPriors(bool with_distortion) const {
    return PriorsOfLenses(cameras_, priors_, with_distortion);
  }
  CircularFigures Settle(const CircularPriors& priors, CircularSteps steps, CircularState* state) const {
    return SettleCircular(data_, priors, steps, options_.noise_px, state);
  }
  void ReportLenses(const CircularState& state, bool distortion_is_free, CircularMotion* motion) const;
  void ReportStations(const CircularState& state, CircularSteps steps, CircularMotion* motion) const;
  // Whether matches are bound to move no farther than a turn can move them: only where the turn may become
  // next to nothing.
  void BindMoves(bool are_bound);

  const std::vector<CircularStation>& stations_;
  const std::vector<Camera>& cameras_;
  const std::vector<FocalPrior>& priors_;
  const CircularOptions& options_;
  Reporter& reporter_;
  std::mt19937 rng_;
  std::vector<CircularMatches> data_;
  std::vector<double> reach_px_;  // of data_
  std::vector<size_t> station_of_data_;
  std::vector<size_t> num_tried_;
  std::vector<Start> closed_;  // of data_, as SearchStation has them
  std::vector<Start> open_;
};

// One lens for all: stations that were fitted alone disagree on it, and each may be right.
CircularState Fitter::BestLenses(const std::vector<const Start*>& starts, CircularSteps steps) const {
  CircularState state;
  for (size_t c = 0; c < cameras_.size(); ++c) {
    state.lenses.push_back({std::log(priors_[c].likeliest.focal_px), DistortionOf(cameras_[c])});
  }
  for (const Start* start : starts) state.turns.push_back(start->state.turns[0]);
  if (starts.size() == 1) {  // which is settled
    state.lenses[static_cast<size_t>(data_[0].lens)] = starts[0]->state.lenses[0];
    state.sigma_px = starts[0]->state.sigma_px;
    return state;
  }
  std::vector<Start> with_lens(std::min(starts.size(), kMaxLenses) + 1);
  for (Start& one : with_lens) one.state = state;
  for (size_t s = 0; s + 1 < with_lens.size(); ++s) {
    with_lens[s + 1].state.lenses[static_cast<size_t>(data_[s].lens)] = starts[s]->state.lenses[0];
  }
  const CircularPriors priors = AllPriors(false);
  ForEachStart(&with_lens, reporter_, [&](Start* one) {
    one->state.sigma_px = options_.noise_px;
    RefineCircular(data_, priors, steps, 12, &one->state, nullptr);
    one->state.sigma_px = 0.5 * options_.noise_px;
    one->log_posterior = RefineCircular(data_, priors, steps, 12, &one->state, nullptr).log_posterior;
  });
  const Start* best = &with_lens[0];
  for (const Start& one : with_lens) {
    if (one.log_posterior > best->log_posterior) best = &one;
  }
  return best->state;
}

// All stations together from one start each: angles free, one lens a camera.
Start Fitter::RefineAll(const std::vector<const Start*>& starts) const {
  Start all;
  all.is_closed = std::all_of(starts.begin(), starts.end(), [](const Start* s) { return s->is_closed; });
  all.steps = all.is_closed ? CircularSteps::kEqualHeld : CircularSteps::kEqual;
  all.state = BestLenses(starts, all.steps);
  const CircularPriors priors = AllPriors(false);
  const CircularFigures equal = Settle(priors, all.steps, &all.state);
  const double charge = 0.5 * std::log(std::max(2.0, equal.inliers));  // for one more unknown
  all.log_posterior = equal.log_posterior;
  if (all.is_closed) {
    // Steps that close leave nothing open; others have to be worth one unknown a station.
    CircularState open = all.state;
    const CircularFigures opened = Settle(priors, CircularSteps::kEqual, &open);
    const double worth = opened.log_posterior - charge * static_cast<double>(data_.size());
    if (worth > all.log_posterior) {
      all.log_posterior = worth;
      all.state = std::move(open);
      all.steps = CircularSteps::kEqual;
    }
  } else {
    all.log_posterior -= charge * static_cast<double>(data_.size());
  }
  FreeSteps(&all);
  for (const Start* start : starts) all.log_posterior += start->log_prior;
  return all;
}

// Where free angles are worth it.
void Fitter::FreeSteps(Start* all) const {
  CircularState free = all->state;
  const double worth = FreeCircularAngles(data_, AllPriors(false), options_.noise_px, &free);
  if (!(worth > all->log_posterior)) return;
  all->log_posterior = worth;
  all->state = std::move(free);
  all->steps = CircularSteps::kFree;
}

void Fitter::ReportStations(const CircularState& state, CircularSteps steps, CircularMotion* motion) const {
  const CircularFigures figures = EvaluateCircular(data_, AllPriors(false), state, true);
  for (size_t s = 0; s < data_.size(); ++s) {
    const CircularMatches& data = data_[s];
    CircularStationFit& fit = motion->stations[station_of_data_[s]];
    fit.gain = figures.gain[s];
    fit.inliers = figures.inliers_of_station[s];
    for (const CircularMatches::Pair& pair : data.pairs) fit.matches += static_cast<int>(pair.matches.size());
    CircularTurn turn = state.turns[s];
    FaceMatches(data, state.lenses[static_cast<size_t>(data.lens)], state.sigma_px, &turn);
    fit.axis = turn.frame.col(2);
    fit.foot = turn.frame.col(0);
    fit.angles_rad = std::move(turn.angles);
    // Equal steps place photos that their own matches do not; a photo without any may be anything.
    const bool are_free = steps == CircularSteps::kFree;
    std::vector<char> has_matches(static_cast<size_t>(data.num_photos), 0);
    for (const CircularMatches::Pair& pair : data.pairs)
      has_matches[static_cast<size_t>(pair.photo1)] = has_matches[static_cast<size_t>(pair.photo2)] = 1;
    for (size_t i = 0; i < has_matches.size(); ++i)
      fit.placed.push_back(
          figures.gain_of_photo[s][i] > kBeyondChance || (!are_free && has_matches[i] != 0) ? 1 : 0);
    // By the Bayesian information criterion against chance, which has no parameters, for the best of all that
    // were tried.
    const double parameters = 5.0 + (are_free ? data.num_photos - 1 : steps == CircularSteps::kEqual ? 1 : 0);
    const double charge = 0.5 * parameters * std::log(std::max(2, fit.matches)) +
                          std::log(std::max<double>(1, static_cast<double>(num_tried_[s])));
    fit.found = fit.gain > charge + kBeyondChance && std::count(fit.placed.begin(), fit.placed.end(), 1) >= 3;
    double span = 0;
    for (size_t i = 1; i < fit.angles_rad.size(); ++i)
      span += WrapAngle(fit.angles_rad[i] - fit.angles_rad[i - 1]);
    const double step = span / (data.num_photos - 1);
    fit.closes = std::abs(std::abs(span + step) - 2 * kPi) < 0.5 * std::abs(step);
  }
}

void Fitter::BindMoves(bool are_bound) {
  for (size_t s = 0; s < data_.size(); ++s) data_[s].reach_px = are_bound ? reach_px_[s] : 0;
}

void Fitter::CollectMatches() {
  for (size_t s = 0; s < stations_.size(); ++s) {
    const Camera& camera = cameras_[static_cast<size_t>(stations_[s].camera)];
    std::optional<CircularMatches> data = MatchesOfStation(stations_[s], camera, options_, &rng_);
    if (!data) continue;
    reach_px_.push_back(data->reach_px);
    data_.push_back(std::move(*data));
    station_of_data_.push_back(s);
  }
}

// Stations that there is nothing to start from are left out.
void Fitter::SearchStations() {
  for (size_t s = 0; s < data_.size(); ++s) {
    reporter_.Progress("fit circular motion", static_cast<int64_t>(s), static_cast<int64_t>(data_.size()));
    const auto lens = static_cast<size_t>(data_[s].lens);
    StationStarts best = SearchStation(data_[s], cameras_[lens], priors_[lens], options_, reporter_);
    if (!best.closed || !best.open) {
      data_.erase(data_.begin() + static_cast<std::ptrdiff_t>(s));
      reach_px_.erase(reach_px_.begin() + static_cast<std::ptrdiff_t>(s));
      station_of_data_.erase(station_of_data_.begin() + static_cast<std::ptrdiff_t>(s));
      --s;
      continue;
    }
    num_tried_.push_back(best.num_tried);
    closed_.push_back(std::move(*best.closed));
    open_.push_back(std::move(*best.open));
  }
}

// Whether some photo is farther from where the other has it than half the way to its neighbour.
bool Fitter::PutsPhotosElsewhere(const Start& a, const Start& b) const {
  for (size_t s = 0; s < data_.size(); ++s) {
    const std::vector<double>& angles = a.state.turns[s].angles;
    const std::vector<double>& others = b.state.turns[s].angles;
    double turned = 0;
    double turned_other = 0;
    for (size_t i = 1; i < angles.size(); ++i) {
      const double step = WrapAngle(angles[i] - angles[i - 1]);
      turned += step;
      turned_other += WrapAngle(others[i] - others[i - 1]);
      if (std::abs(std::abs(turned) - std::abs(turned_other)) > 0.5 * std::abs(step)) return true;
    }
  }
  return false;
}

// Where the turns close, where they do not, and each station as it is likelier by itself.
Fitter::Together Fitter::BestTogether() {
  std::vector<const Start*> all_closed;
  std::vector<const Start*> all_open;
  std::vector<const Start*> each_best;
  for (size_t s = 0; s < data_.size(); ++s) {
    all_closed.push_back(&closed_[s]);
    all_open.push_back(&open_[s]);
    each_best.push_back(closed_[s].log_posterior >= open_[s].log_posterior ? &closed_[s] : &open_[s]);
  }
  BindMoves(false);
  std::vector<Start> starts = {RefineAll(all_closed)};
  BindMoves(true);
  starts.push_back(RefineAll(all_open));
  Together together;
  together.closed_log_posterior = starts[0].log_posterior;
  together.open_log_posterior = starts[1].log_posterior;
  reporter_.Debug("circles: turns that close " + std::to_string(together.closed_log_posterior) + ", others " +
                  std::to_string(together.open_log_posterior));
  if (each_best != all_closed && each_best != all_open) starts.push_back(RefineAll(each_best));
  std::stable_sort(starts.begin(), starts.end(),
                   [](const Start& a, const Start& b) { return a.log_posterior > b.log_posterior; });
  together.best = std::move(starts[0]);
  for (size_t k = 1; k < starts.size() && !together.rival; ++k) {
    if (starts[k].log_posterior + kBeyondChance > together.best.log_posterior &&
        PutsPhotosElsewhere(together.best, starts[k]))
      together.rival = std::move(starts[k]);
  }
  return together;
}

// Distortion counts as one unknown a camera and has to be worth it; returns whether it is.
// \param priors  gets those that `best` is at its maximum with.
bool Fitter::FreeDistortion(Start* best, CircularPriors* priors) const {
  *priors = AllPriors(true);
  priors->angles = best->state.turns;
  Start bent = *best;
  const CircularFigures figures = Settle(*priors, bent.steps, &bent.state);
  const auto num_free = std::count_if(cameras_.begin(), cameras_.end(), [](const Camera& camera) {
    return DistortionPlace(camera).has_value();
  });
  const double cost = 0.5 * static_cast<double>(num_free) * std::log(std::max(2.0, figures.inliers));
  const double straight = EvaluateCircular(data_, AllPriors(false), best->state, false).log_posterior;
  const double gain = figures.log_posterior - straight - cost;
  if (num_free > 0 && gain > 0) {
    *best = std::move(bent);
    best->log_posterior += gain;
    return true;
  }
  *priors = AllPriors(false);
  priors->angles = best->state.turns;
  return false;
}

void Fitter::ReportLenses(const CircularState& state, bool distortion_is_free, CircularMotion* motion) const {
  for (size_t c = 0; c < cameras_.size(); ++c) {
    Camera& camera = motion->cameras[c];
    const CameraModelInfo& info = InfoOf(camera.model);
    if (!IsPerspective(camera.model)) continue;
    const double factor = std::exp(state.lenses[c].log_focal) / FocalLengths(camera).x();
    for (size_t k = 0; k < info.num_focal_params; ++k) camera.params[k] *= factor;
    const std::optional<size_t> place = DistortionPlace(camera);
    if (!distortion_is_free || !place) continue;
    camera.params[*place] = state.lenses[c].distortion;
    motion->distortion_is_free[c] = 1;
  }
}

CircularMotion Fitter::Nothing() const {
  CircularMotion motion;
  motion.cameras = cameras_;
  motion.focal_sigma_log.assign(cameras_.size(), 0);
  motion.distortion_is_free.assign(cameras_.size(), 0);
  motion.stations.resize(stations_.size());
  return motion;
}

CircularMotion Fitter::Conclude(Start best) {
  CircularMotion motion = Nothing();
  BindMoves(!best.is_closed);
  CircularPriors priors;
  const bool is_free = FreeDistortion(&best, &priors);
  RefineCircular(data_, priors, best.steps, 5, &best.state, &motion.focal_sigma_log);
  motion.steps_are_equal = best.steps != CircularSteps::kFree;
  motion.log_posterior = best.log_posterior;
  motion.sigma_px = best.state.sigma_px;
  ReportLenses(best.state, is_free, &motion);
  ReportStations(best.state, best.steps, &motion);
  return motion;
}

CircularMotion Fitter::Fit() {
  CollectMatches();
  SearchStations();
  if (data_.empty()) return Nothing();
  Together together = BestTogether();
  CircularMotion motion = Conclude(std::move(together.best));
  motion.closed_log_posterior = together.closed_log_posterior;
  motion.open_log_posterior = together.open_log_posterior;
  if (together.rival) motion.rivals.push_back(Conclude(std::move(*together.rival)));
  return motion;
}

}  // namespace

OptionCheck CircularOptions::Check() const {
  const auto fault = [](const char* field, double value, const char* bound) {
    return OptionFault{field, NumberText(value), bound};
  };
  if (!(noise_px > 0)) return fault("noise_px", noise_px, "noise_px > 0");
  if (max_matches < 3) return fault("max_matches", max_matches, "max_matches >= 3");
  if (num_refined < 1) return fault("num_refined", num_refined, "num_refined >= 1");
  if (min_photos < 3) return fault("min_photos", min_photos, "min_photos >= 3");
  return std::nullopt;
}

CircularMotion FitCircularMotion(const std::vector<CircularStation>& stations,
                                 const std::vector<Camera>& cameras, const std::vector<FocalPrior>& priors,
                                 const CircularOptions& options, Reporter& reporter) {
  S2GS_INVARIANT(!options.Check() && priors.size() == cameras.size());
  return Fitter(stations, cameras, priors, options, reporter).Fit();
}

}  // namespace s2gs
