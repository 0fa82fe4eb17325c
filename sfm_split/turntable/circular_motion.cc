#include "sfm_split/turntable/circular_motion.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numeric>
#include <optional>
#include <random>
#include <string>

#include "sfm_split/base/rotation.h"
#include "sfm_split/turntable/circular_likelihood.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kPi = 3.14159265358979323846;
constexpr double kDegree = kPi / 180;
constexpr double kDistortionSigma = 0.15;  // lenses have -0.35 to 0.1
constexpr size_t kRankMatches = 300;       // that rank the starting points
constexpr size_t kSearchMatches = 1500;    // that these are refined with
constexpr int kSearchSteps = 4;            // between the photos of the pairs in the search, around the circle
constexpr double kCoarseNoise = 4;         // times the noise, while everything is far off
constexpr double kLeastSigmaPx = 0.1;      // rounding is no noise
constexpr double kCertain = 8;             // e^-8: what is believed against chance
constexpr double kUniformWidth = 3.4641;   // of a uniform distribution, over its standard deviation

struct Start {
  double log_posterior = 0;  // less what the Bayesian information criterion charges for free angles
  bool is_closed = false;
  CircularSteps steps = CircularSteps::kEqual;
  CircularState state;
};

bool IsPerspective(CameraModelId model) {
  return model == CameraModelId::kSimplePinhole || model == CameraModelId::kPinhole ||
         model == CameraModelId::kSimpleRadial || model == CameraModelId::kRadial ||
         model == CameraModelId::kOpenCV || model == CameraModelId::kFullOpenCV;
}

bool HasDistortion(CameraModelId model) {
  return IsPerspective(model) && InfoOf(model).num_extra_params > 0;
}

double DistortionOf(const Camera& camera) {
  return HasDistortion(camera.model) ? camera.params[InfoOf(camera.model).FirstExtraParam()] : 0;
}

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
  std::optional<CircularMatches> Collect(const CircularStation& station);
  CircularMatches Sample(const CircularMatches& all, size_t num) const;
  CircularState StateOf(const CircularMatches& station, const Vector2d& middle, double focal_px,
                        double elevation, double step) const;
  void Search(size_t station, std::optional<Start>* closed, std::optional<Start>* open) const;
  Start RefineAll(const std::vector<const Start*>& starts) const;
  CircularPriors PriorsOf(size_t lens, bool with_distortion) const;
  CircularPriors AllPriors(const std::vector<bool>& with_distortion) const;
  CircularFigures Settle(const CircularPriors& priors, CircularSteps steps, CircularState* state) const;
  void Report(const CircularState& state, CircularMotion* motion) const;

  const std::vector<CircularStation>& stations_;
  const std::vector<Camera>& cameras_;
  const std::vector<FocalPrior>& priors_;
  const CircularOptions& options_;
  Reporter& reporter_;
  std::mt19937 rng_;
  std::vector<CircularMatches> data_;
  std::vector<size_t> station_of_data_;
};

// Matches as seen from the principal point. Nothing when the station has too little to fit.
std::optional<CircularMatches> Fitter::Collect(const CircularStation& station) {
  const Camera& camera = cameras_[static_cast<size_t>(station.camera)];
  if (station.num_photos < options_.min_photos || !IsPerspective(camera.model)) return std::nullopt;
  const Vector2d middle = PrincipalPoint(camera);
  const Vector2d focal = FocalLengths(camera);
  const Vector2d aspect(1, focal.x() / focal.y());
  CircularMatches result;
  result.lens = station.camera;
  result.num_photos = station.num_photos;
  Vector2d sum = Vector2d::Zero();
  Vector2d squares = Vector2d::Zero();
  double num = 0;
  for (const CircularPair& given : station.pairs) {
    if (given.matches.empty()) continue;
    CircularMatches::Pair pair{given.photo1, given.photo2, {}};
    for (const auto& [first, second] : given.matches) {
      pair.matches.emplace_back((first - middle).cwiseProduct(aspect),
                                (second - middle).cwiseProduct(aspect));
    }
    std::shuffle(pair.matches.begin(), pair.matches.end(), rng_);
    if (pair.matches.size() > static_cast<size_t>(options_.max_matches))
      pair.matches.resize(static_cast<size_t>(options_.max_matches));
    for (const auto& [first, second] : pair.matches) {
      sum += first + second;
      squares += first.cwiseAbs2() + second.cwiseAbs2();
      num += 2;
    }
    result.pairs.push_back(std::move(pair));
  }
  if (num < 2 * kRankMatches / 10.0) return std::nullopt;
  const Vector2d mean = sum / num;
  const double deviation = std::sqrt(std::max(1.0, (squares / num - mean.cwiseAbs2()).mean()));
  result.chance = 1 / (kUniformWidth * deviation);
  return result;
}

// Matches of photos a few steps apart, around the circle, evenly.
CircularMatches Fitter::Sample(const CircularMatches& all, size_t num) const {
  const auto is_close = [&](const CircularMatches::Pair& pair) {
    const int steps = std::abs(pair.photo2 - pair.photo1);
    return std::min(steps, all.num_photos - steps) <= kSearchSteps;
  };
  size_t total = 0;
  for (const CircularMatches::Pair& pair : all.pairs) total += is_close(pair) ? pair.matches.size() : 0;
  const size_t stride = std::max<size_t>(1, total / num);
  CircularMatches sample = all;
  sample.pairs.clear();
  size_t at = 0;
  for (const CircularMatches::Pair& pair : all.pairs) {
    if (!is_close(pair)) continue;
    CircularMatches::Pair some{pair.photo1, pair.photo2, {}};
    for (const auto& match : pair.matches) {
      if (at++ % stride == 0) some.matches.push_back(match);
    }
    if (!some.matches.empty()) sample.pairs.push_back(std::move(some));
  }
  return sample;
}

// A camera that looks down at the table, the axis behind the middle of what moves.
CircularState Fitter::StateOf(const CircularMatches& station, const Vector2d& middle, double focal_px,
                              double elevation, double step) const {
  CircularState state;
  state.lenses = {{std::log(focal_px), 0}};
  CircularTurn turn;
  const Vector3d axis(0, -std::cos(elevation), -std::sin(elevation));
  const Vector3d ray = Vector3d(middle.x() / focal_px, 0, 1);
  const Vector3d foot = (ray - ray.dot(axis) * axis).normalized();
  turn.frame << foot, axis.cross(foot), axis;
  for (int i = 0; i < station.num_photos; ++i) turn.angles.push_back(i * step);
  state.turns = {std::move(turn)};
  return state;
}

void AddFocalPrior(const Camera& camera, const FocalPrior& prior, CircularPriors* priors) {
  const double side = std::log(static_cast<double>(std::max(camera.width, camera.height)));
  priors->focal.push_back(prior);
  priors->least_log_focal.push_back(side + std::log(kLeastFocalShare));
  priors->most_log_focal.push_back(side + std::log(kMostFocalShare));
}

CircularPriors Fitter::PriorsOf(size_t lens, bool with_distortion) const {
  CircularPriors priors;
  AddFocalPrior(cameras_[lens], priors_[lens], &priors);
  priors.distortion = {DistortionOf(cameras_[lens])};
  priors.distortion_sigma = with_distortion ? kDistortionSigma : 0;
  return priors;
}

// The best equal steps of one station, where they close after its photos and where they are of any size.
void Fitter::Search(size_t station, std::optional<Start>* closed, std::optional<Start>* open) const {
  const auto lens = static_cast<size_t>(data_[station].lens);
  std::vector<CircularMatches> few = {Sample(data_[station], kRankMatches)};
  std::vector<CircularMatches> many = {Sample(data_[station], kSearchMatches)};
  few[0].lens = many[0].lens = 0;
  Vector2d middle = Vector2d::Zero();
  double num = 0;
  for (const CircularMatches::Pair& pair : many[0].pairs) {
    for (const auto& [first, second] : pair.matches) {
      middle += first + second;
      num += 2;
    }
  }
  if (num == 0) return;
  middle /= num;
  const CircularPriors priors = PriorsOf(lens, HasDistortion(cameras_[lens].model));
  std::vector<double> steps;
  for (const double degrees : {1.5, 3.0, 6.0, 10.0, 15.0, 20.0, 30.0, 40.0, 60.0, 90.0})
    steps.push_back(degrees * kDegree);
  for (const bool is_closed : {true, false}) {
    std::vector<Start> starts;
    for (const double factor : {-1.5, 0.0, 1.5}) {
      const double focal_px = priors_[lens].focal_px * std::exp(factor * priors_[lens].sigma_log);
      for (const double elevation_deg : {5.0, 20.0, 40.0, 60.0, 80.0}) {
        for (const double step :
             is_closed ? std::vector<double>{2 * kPi / data_[station].num_photos} : steps) {
          for (const double sense : {1.0, -1.0}) {
            Start start;
            start.is_closed = is_closed;
            start.state =
                StateOf(few[0], middle, focal_px, elevation_deg * kDegree, sense * step);
            start.state.lenses[0].distortion = priors.distortion[0];
            start.state.sigma_px = kCoarseNoise * options_.noise_px;
            start.log_posterior = EvaluateCircular(few, priors, start.state, false).log_posterior;
            starts.push_back(std::move(start));
          }
        }
      }
    }
    std::stable_sort(starts.begin(), starts.end(),
                     [](const Start& a, const Start& b) { return a.log_posterior > b.log_posterior; });
    starts.resize(std::min(starts.size(), static_cast<size_t>(options_.num_refined)));
    const CircularSteps mode = is_closed ? CircularSteps::kEqualHeld : CircularSteps::kEqual;
    std::optional<Start>& best = is_closed ? *closed : *open;
    for (Start& start : starts) {
      if (reporter_.StopRequested()) throw Interrupted();
      RefineCircular(few, priors, mode, 15, &start.state, nullptr);
      start.state.sigma_px = 2 * options_.noise_px;
      RefineCircular(many, priors, mode, 15, &start.state, nullptr);
      start.state.sigma_px = options_.noise_px;
      start.log_posterior = RefineCircular(many, priors, mode, 15, &start.state, nullptr).log_posterior;
      if (!best || start.log_posterior > best->log_posterior) best = start;
    }
  }
}

// To the maximum, sigma included.
CircularFigures Fitter::Settle(const CircularPriors& priors, CircularSteps steps,
                               CircularState* state) const {
  for (int round = 0; round < 6; ++round) {
    const CircularFigures figures = RefineCircular(data_, priors, steps, 25, state, nullptr);
    const double sigma = std::clamp(figures.sigma_px, kLeastSigmaPx, options_.noise_px);
    const bool is_settled = std::abs(sigma - state->sigma_px) <= 0.01 * state->sigma_px;
    state->sigma_px = sigma;
    if (is_settled) break;
  }
  return EvaluateCircular(data_, priors, *state, false);
}

CircularPriors Fitter::AllPriors(const std::vector<bool>& with_distortion) const {
  CircularPriors priors;
  bool any = false;
  for (size_t c = 0; c < cameras_.size(); ++c) {
    AddFocalPrior(cameras_[c], priors_[c], &priors);
    priors.distortion.push_back(DistortionOf(cameras_[c]));
    any |= with_distortion[c];
  }
  priors.distortion_sigma = any ? kDistortionSigma : 0;
  return priors;
}

// All stations together from one start each: angles free, one lens a camera.
Start Fitter::RefineAll(const std::vector<const Start*>& starts) const {
  Start all;
  all.is_closed = std::all_of(starts.begin(), starts.end(), [](const Start* s) { return s->is_closed; });
  std::vector<std::vector<CircularLens>> lenses(cameras_.size());
  for (size_t s = 0; s < starts.size(); ++s) {
    all.state.turns.push_back(starts[s]->state.turns[0]);
    lenses[static_cast<size_t>(data_[s].lens)].push_back(starts[s]->state.lenses[0]);
  }
  std::vector<bool> with_distortion;
  for (size_t c = 0; c < cameras_.size(); ++c) {
    std::vector<CircularLens>& of_camera = lenses[c];
    CircularLens lens{std::log(priors_[c].focal_px), DistortionOf(cameras_[c])};
    if (!of_camera.empty()) {
      std::sort(of_camera.begin(), of_camera.end(), [](const CircularLens& a, const CircularLens& b) {
        return a.log_focal < b.log_focal;
      });
      lens = of_camera[of_camera.size() / 2];
    }
    all.state.lenses.push_back(lens);
    with_distortion.push_back(HasDistortion(cameras_[c].model));
  }
  CircularPriors priors = AllPriors(with_distortion);
  // One lens for all first: stations that were fitted alone disagree on it.
  all.state.sigma_px = 2 * options_.noise_px;
  RefineCircular(data_, priors, CircularSteps::kEqual, 15, &all.state, nullptr);
  all.state.sigma_px = options_.noise_px;
  const CircularFigures equal = Settle(priors, CircularSteps::kEqual, &all.state);
  all.log_posterior = equal.log_posterior;

  CircularState free = all.state;
  priors.angles = free.turns;
  free.sigma_px = kCoarseNoise * options_.noise_px;
  RefineCircular(data_, priors, CircularSteps::kFree, 15, &free, nullptr);
  free.sigma_px = options_.noise_px;
  const CircularFigures freed = Settle(priors, CircularSteps::kFree, &free);
  double extra = 0;
  for (const CircularMatches& station : data_) extra += station.num_photos - 2;
  const double worth = freed.log_posterior - 0.5 * extra * std::log(std::max(2.0, freed.inliers));
  if (worth > all.log_posterior) {
    all.log_posterior = worth;
    all.state = std::move(free);
    all.steps = CircularSteps::kFree;
  }
  return all;
}

void Fitter::Report(const CircularState& state, CircularMotion* motion) const {
  const CircularFigures figures = EvaluateCircular(data_, AllPriors(std::vector<bool>(cameras_.size(), false)),
                                                   state, true);
  for (size_t s = 0; s < data_.size(); ++s) {
    const CircularMatches& data = data_[s];
    CircularStationFit& fit = motion->stations[station_of_data_[s]];
    fit.gain = figures.gain[s];
    fit.inliers = figures.inliers_of_station[s];
    for (const CircularMatches::Pair& pair : data.pairs) fit.matches += static_cast<int>(pair.matches.size());
    fit.axis = state.turns[s].frame.col(2);
    fit.foot = state.turns[s].frame.col(0);
    fit.angles_rad = state.turns[s].angles;
    for (const double gain : figures.gain_of_photo[s]) fit.placed.push_back(gain > kCertain ? 1 : 0);
    // By the Bayesian information criterion against chance, which has no parameters.
    const double parameters = 5.0 + data.num_photos - 1;
    fit.found = fit.gain > 0.5 * parameters * std::log(std::max(2, fit.matches)) + kCertain &&
                std::count(fit.placed.begin(), fit.placed.end(), 1) >= 3;
    double span = 0;
    for (size_t i = 1; i < fit.angles_rad.size(); ++i)
      span += WrapAngle(fit.angles_rad[i] - fit.angles_rad[i - 1]);
    const double step = span / (data.num_photos - 1);
    fit.closes = std::abs(std::abs(span + step) - 2 * kPi) < 0.5 * std::abs(step);
  }
}

CircularMotion Fitter::Fit() {
  CircularMotion motion;
  motion.cameras = cameras_;
  motion.focal_sigma_log.assign(cameras_.size(), 0);
  motion.distortion_is_free.assign(cameras_.size(), 0);
  motion.stations.resize(stations_.size());
  for (size_t s = 0; s < stations_.size(); ++s) {
    std::optional<CircularMatches> data = Collect(stations_[s]);
    if (!data) continue;
    data_.push_back(std::move(*data));
    station_of_data_.push_back(s);
  }
  std::vector<Start> closed;
  std::vector<Start> open;
  for (size_t s = 0; s < data_.size(); ++s) {
    reporter_.Progress("fit circular motion", static_cast<int64_t>(s), static_cast<int64_t>(data_.size()));
    std::optional<Start> best_closed;
    std::optional<Start> best_open;
    Search(s, &best_closed, &best_open);
    if (!best_closed || !best_open) {
      data_.erase(data_.begin() + static_cast<std::ptrdiff_t>(s));
      station_of_data_.erase(station_of_data_.begin() + static_cast<std::ptrdiff_t>(s));
      --s;
      continue;
    }
    closed.push_back(std::move(*best_closed));
    open.push_back(std::move(*best_open));
  }
  if (data_.empty()) return motion;
  std::vector<const Start*> all_closed;
  std::vector<const Start*> all_open;
  std::vector<const Start*> each_best;
  for (size_t s = 0; s < data_.size(); ++s) {
    all_closed.push_back(&closed[s]);
    all_open.push_back(&open[s]);
    each_best.push_back(closed[s].log_posterior >= open[s].log_posterior ? &closed[s] : &open[s]);
  }
  Start best = RefineAll(all_closed);
  motion.closed_log_posterior = best.log_posterior;
  Start other = RefineAll(all_open);
  motion.open_log_posterior = other.log_posterior;
  if (other.log_posterior > best.log_posterior) best = std::move(other);
  if (each_best != all_closed && each_best != all_open) {
    other = RefineAll(each_best);
    if (other.log_posterior > best.log_posterior) best = std::move(other);
  }

  // Distortion counts as one parameter a camera and has to be worth it.
  std::vector<bool> with_distortion;
  for (const Camera& camera : cameras_) with_distortion.push_back(HasDistortion(camera.model));
  CircularPriors held = AllPriors(std::vector<bool>(cameras_.size(), false));
  held.angles = best.state.turns;
  Start simple = best;
  for (size_t c = 0; c < cameras_.size(); ++c) simple.state.lenses[c].distortion = held.distortion[c];
  const CircularFigures bent = EvaluateCircular(data_, AllPriors(with_distortion), best.state, false);
  const CircularFigures straight = Settle(held, simple.steps, &simple.state);
  const auto num_free = std::count(with_distortion.begin(), with_distortion.end(), true);
  const double cost = 0.5 * static_cast<double>(num_free) * std::log(std::max(2.0, straight.inliers));
  const bool is_free = bent.log_posterior - straight.log_posterior > cost;
  if (!is_free) {
    simple.log_posterior += straight.log_posterior - bent.log_posterior;
    best = std::move(simple);
  }
  CircularPriors priors = is_free ? AllPriors(with_distortion) : held;
  priors.angles = best.state.turns;
  RefineCircular(data_, priors, best.steps, 5, &best.state, &motion.focal_sigma_log);
  motion.steps_are_equal = best.steps == CircularSteps::kEqual;

  motion.log_posterior = best.log_posterior;
  motion.sigma_px = best.state.sigma_px;
  for (size_t c = 0; c < cameras_.size(); ++c) {
    Camera& camera = motion.cameras[c];
    const CameraModelInfo& info = InfoOf(camera.model);
    if (!IsPerspective(camera.model)) continue;
    const double factor = std::exp(best.state.lenses[c].log_focal) / FocalLengths(camera).x();
    for (size_t k = 0; k < info.num_focal_params; ++k) camera.params[k] *= factor;
    if (!is_free || !with_distortion[c]) continue;
    camera.params[info.FirstExtraParam()] = best.state.lenses[c].distortion;
    motion.distortion_is_free[c] = 1;
  }
  Report(best.state, &motion);
  return motion;
}

}  // namespace

OptionCheck CircularOptions::Check() const {
  const auto fault = [](const char* field, double value, const char* bound) {
    return OptionFault{field, std::to_string(value), bound};
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
