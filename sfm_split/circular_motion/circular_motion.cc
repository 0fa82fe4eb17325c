#include "sfm_split/circular_motion/circular_motion.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <map>
#include <numeric>
#include <optional>
#include <random>
#include <string>
#include <utility>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/number_text.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/circular_motion/circular_likelihood.h"
#include "sfm_split/circular_motion/match_mixture.h"
#include "sfm_split/circular_motion/table_views.h"
#include "sfm_split/circular_motion/turn_reach.h"
#include "sfm_split/circular_motion/wrong_matches.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr size_t kRankMatches = 1000;    // that rank the starting points
constexpr size_t kMinMatches = 30;       // of a station
constexpr size_t kSearchMatches = 3000;  // that these are refined with
constexpr int kSearchSteps = 3;          // between the photos of the pairs in the search, around the circle
constexpr size_t kMaxLenses = 8;         // that all stations together start from
constexpr size_t kNumFinished = 3;       // of the different optima that refined starts come to
constexpr double kOneOptimum = 4 * kPi / 180;  // between axes: half of what the starts lie apart
constexpr double kOneStep = 0.15;              // between steps, as a share: half of what the starts lie apart
constexpr double kBelowTable =
    5 * kPi / 180;                // standard deviation of how far a camera stands below the table
constexpr double kUpright = 0.9;  // of photos, as they are stored; either side has half the next
// Both sides together: with the two others a judgement, as no photo should be ruled out.
constexpr double kOnTheSide = 0.045;
constexpr double kOnTheHead = 0.01;  // a judgement, likewise
constexpr double kCoarseNoise = 2;   // times the noise, while everything is far off
constexpr double kCertain = 8;       // e^-8: what is believed against chance

struct Start {
  double log_posterior = 0;  // less what the Bayesian information criterion charges for free angles
  bool is_closed = false;
  size_t view = 0;  // which side of the picture is up, and which way the table turns
  CircularSteps steps = CircularSteps::kEqual;
  CircularState state;
};

bool IsPerspective(CameraModelId model) {
  return model == CameraModelId::kSimplePinhole || model == CameraModelId::kPinhole ||
         model == CameraModelId::kSimpleRadial || model == CameraModelId::kRadial ||
         model == CameraModelId::kOpenCV || model == CameraModelId::kFullOpenCV;
}

double DistortionOf(const Camera& camera) {
  const std::optional<size_t> place = DistortionPlace(camera);
  return place ? camera.params[*place] : 0;
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
                        double elevation, const Vector2d& up, double step) const;
  void Search(size_t station, std::optional<Start>* closed, std::optional<Start>* open) const;
  // From several threads: each start by itself.
  template <typename Work>
  void ForEach(std::vector<Start>* starts, const Work& work) const {
    ParallelFor(static_cast<int64_t>(starts->size()), 0, [&](int64_t i) {
      if (reporter_.StopRequested()) throw Interrupted();
      work(&(*starts)[static_cast<size_t>(i)]);
    });
  }
  Start RefineAll(const std::vector<const Start*>& starts) const;
  CircularPriors PriorsOf(size_t lens) const;
  CircularPriors AllPriors(bool with_distortion) const;
  CircularFigures Settle(const CircularPriors& priors, CircularSteps steps, CircularState* state) const;
  void Report(const CircularState& state, CircularSteps steps, CircularMotion* motion) const;

  const std::vector<CircularStation>& stations_;
  const std::vector<Camera>& cameras_;
  const std::vector<FocalPrior>& priors_;
  const CircularOptions& options_;
  Reporter& reporter_;
  std::mt19937 rng_;
  // Whether matches are bound to move no farther than a turn can move them: only where the turn may become
  // next to nothing.
  void BindMoves(bool are_bound);

  std::vector<CircularMatches> data_;
  std::vector<double> reach_px_;  // of data_
  std::vector<size_t> station_of_data_;
};

int StepsBetween(const CircularMatches::Pair& pair, int num_photos) {
  const int steps = std::abs(pair.photo2 - pair.photo1);
  return std::min(steps, num_photos - steps);
}

// \param extent  of the object [px].
void FillChance(double extent, CircularMatches* data) {
  std::vector<const CircularMatches::Pair*> pairs;
  size_t total = 0;
  for (const CircularMatches::Pair& pair : data->pairs) {
    pairs.push_back(&pair);
    total += pair.matches.size();
  }
  std::stable_sort(pairs.begin(), pairs.end(), [&](const auto* a, const auto* b) {
    return StepsBetween(*a, data->num_photos) > StepsBetween(*b, data->num_photos);
  });
  const auto move_of = [&](const CircularMatches::Pair& pair, const CircularMatch& match) {
    return MatchMove{match.second - match.first, TurnBetween(pair.photo1, pair.photo2, data->num_photos)};
  };
  std::vector<MatchMove> moves;
  for (const CircularMatches::Pair* pair : pairs) {
    if (static_cast<double>(moves.size()) > kFarShare * static_cast<double>(total)) break;
    for (const CircularMatch& match : pair->matches) moves.push_back(move_of(*pair, match));
  }
  const WrongMatches wrong(moves, extent);
  for (CircularMatches::Pair& pair : data->pairs) {
    for (CircularMatch& match : pair.matches) match.chance = wrong.Chance(move_of(pair, match));
  }
}

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
  KeypointExtent extent;
  size_t num = 0;
  std::vector<float> x;
  std::vector<float> y;
  for (const CircularPair& given : station.pairs) {
    if (given.matches.empty()) continue;
    CircularMatches::Pair pair{given.photo1, given.photo2, {}};
    for (const auto& [first, second] : given.matches) {
      pair.matches.push_back(
          {(first - middle).cwiseProduct(aspect), (second - middle).cwiseProduct(aspect), 0});
    }
    std::shuffle(pair.matches.begin(), pair.matches.end(), rng_);
    if (pair.matches.size() > static_cast<size_t>(options_.max_matches))
      pair.matches.resize(static_cast<size_t>(options_.max_matches));
    for (const CircularMatch& match : pair.matches) {
      extent.Add(match.first);
      extent.Add(match.second);
      ++num;
      x.push_back(static_cast<float>(match.first.x()));
      y.push_back(static_cast<float>(match.first.y()));
    }
    result.pairs.push_back(std::move(pair));
  }
  if (num < kMinMatches) return std::nullopt;
  result.reach_px = kMagnification * SweptPx(std::move(x), std::move(y));
  FillChance(extent.Px(), &result);
  return result;
}

// Matches of photos a few steps apart, around the circle, evenly.
CircularMatches Fitter::Sample(const CircularMatches& all, size_t num) const {
  const auto is_close = [&](const CircularMatches::Pair& pair) {
    return StepsBetween(pair, all.num_photos) <= kSearchSteps;
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
// \param up  of the axis in the picture.
CircularState Fitter::StateOf(const CircularMatches& station, const Vector2d& middle, double focal_px,
                              double elevation, const Vector2d& up, double step) const {
  CircularState state;
  state.lenses = {{std::log(focal_px), 0}};
  CircularTurn turn;
  const Vector3d axis = AxisInCamera(up, elevation);
  const Vector2d across = middle - middle.dot(up) * up;
  Vector3d ray;
  ray << across / focal_px, 1;
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

CircularPriors Fitter::PriorsOf(size_t lens) const {
  CircularPriors priors;
  AddFocalPrior(cameras_[lens], priors_[lens], &priors);
  priors.distortion = {DistortionOf(cameras_[lens])};
  return priors;
}

// What is known before the matches of where a camera stands that sees the table's axis point up this way.
// Cameras look level or down at a table: seen from below, it hides what stands on it. Most photos are
// upright, some lie on their side, few stand on their head.
double LogPriorOfView(const Vector3d& up) {
  const double below = std::asin(std::clamp(up.z(), 0.0, 1.0)) / kBelowTable;
  const double share = std::abs(up.x()) > std::abs(up.y()) ? kOnTheSide : up.y() < 0 ? kUpright : kOnTheHead;
  return std::log(share) - 0.5 * below * below;
}

// An axis and the opposite one, about which everything turns the other way, are the same motion: takes the
// likelier one for up. The mirror image of a view from above is one from below. Returns what LogPriorOfView()
// says of it.
double PointAxisUp(CircularTurn* turn) {
  const double as_is = LogPriorOfView(turn->frame.col(2));
  const double turned = LogPriorOfView(-turn->frame.col(2));
  if (as_is >= turned) return as_is;
  turn->frame.rightCols<2>() *= -1;
  for (double& angle : turn->angles) angle = -angle;
  return turned;
}

void SortByPosterior(std::vector<Start>* starts) {
  std::stable_sort(starts->begin(), starts->end(),
                   [](const Start& a, const Start& b) { return a.log_posterior > b.log_posterior; });
}

// So many at most of each view: which is right cannot be told before they are refined.
std::vector<Start> BestOfEachView(std::vector<Start> starts, int num) {
  SortByPosterior(&starts);
  std::map<size_t, int> taken;
  std::vector<Start> kept;
  for (Start& start : starts) {
    if (taken[start.view]++ < num) kept.push_back(std::move(start));
  }
  return kept;
}

// The best starts that have come to different optima: a station whose perspective is weak has two at least,
// the second its mirror image, and where many starts come to the one it may be the other that is right.
std::vector<Start> DifferentOptima(std::vector<Start> starts, size_t num) {
  SortByPosterior(&starts);
  std::vector<Start> kept;
  for (Start& start : starts) {
    if (kept.size() == num) break;
    const CircularTurn& turn = start.state.turns[0];
    const bool is_new = std::none_of(kept.begin(), kept.end(), [&](const Start& better) {
      const CircularTurn& other = better.state.turns[0];
      return turn.frame.col(2).dot(other.frame.col(2)) > std::cos(kOneOptimum) &&
             std::abs(turn.angles[1] - other.angles[1]) < kOneStep * std::abs(other.angles[1]);
    });
    if (is_new) kept.push_back(std::move(start));
  }
  return kept;
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
    for (const CircularMatch& match : pair.matches) {
      middle += match.first + match.second;
      num += 2;
    }
  }
  if (num == 0) return;
  middle /= num;
  const CircularPriors priors = PriorsOf(lens);
  std::vector<double> steps;
  for (const double degrees : {1.5, 3.0, 6.0, 10.0, 15.0, 20.0, 30.0, 40.0, 60.0, 90.0})
    steps.push_back(degrees * kDegree);
  std::vector<std::pair<Vector2d, double>> views;
  for (const Vector2d& up : UpDirections()) {
    for (const double sense : {1.0, -1.0}) views.emplace_back(up, sense);
  }
  // Whether a turn that became next to nothing explains anything is asked when all matches are compared.
  few[0].reach_px = many[0].reach_px = 0;
  for (const bool is_closed : {true, false}) {
    std::vector<Start> starts;
    for (const double factor : {-1.5, 0.0, 1.5}) {
      const double focal_px = priors_[lens].focal_px * std::exp(factor * priors_[lens].sigma_log);
      for (const double elevation_deg : kElevationsDeg) {
        for (const double step :
             is_closed ? std::vector<double>{2 * kPi / data_[station].num_photos} : steps) {
          for (size_t view = 0; view < views.size(); ++view) {
            const auto& [up, sense] = views[view];
            Start start;
            start.is_closed = is_closed;
            start.view = view;
            start.state = StateOf(few[0], middle, focal_px, elevation_deg * kDegree, up, sense * step);
            start.state.lenses[0].distortion = priors.distortion[0];
            start.state.sigma_px = kCoarseNoise * options_.noise_px;
            starts.push_back(std::move(start));
          }
        }
      }
    }
    ForEach(&starts, [&](Start* start) {
      start->log_posterior = EvaluateCircular(few, priors, start->state, false).log_posterior;
    });
    starts = BestOfEachView(std::move(starts), options_.num_refined);
    const CircularSteps mode = is_closed ? CircularSteps::kEqualHeld : CircularSteps::kEqual;
    std::optional<Start>& best = is_closed ? *closed : *open;
    ForEach(&starts, [&](Start* start) {
      RefineCircular(few, priors, mode, 12, &start->state, nullptr);
      start->state.sigma_px = options_.noise_px;
      start->log_posterior = RefineCircular(few, priors, mode, 8, &start->state, nullptr).log_posterior;
    });
    starts = DifferentOptima(std::move(starts), kNumFinished);
    ForEach(&starts, [&](Start* start) {
      start->state.sigma_px = 0.5 * options_.noise_px;
      start->log_posterior = RefineCircular(many, priors, mode, 15, &start->state, nullptr).log_posterior;
      start->log_posterior += PointAxisUp(&start->state.turns[0]);
    });
    for (Start& start : starts) {
      if (!best || start.log_posterior > best->log_posterior) best = std::move(start);
    }
    reporter_.Debug(std::string(is_closed ? "closed" : "open") + ": log-likelihood " +
                    std::to_string(best->log_posterior) + ", step " +
                    std::to_string(best->state.turns[0].angles[1] / kDegree) + ", focal length " +
                    std::to_string(std::exp(best->state.lenses[0].log_focal)));
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

CircularPriors Fitter::AllPriors(bool with_distortion) const {
  CircularPriors priors;
  for (size_t c = 0; c < cameras_.size(); ++c) {
    AddFocalPrior(cameras_[c], priors_[c], &priors);
    priors.distortion.push_back(DistortionOf(cameras_[c]));
  }
  priors.distortion_sigma = with_distortion ? kDistortionSigma : 0;
  return priors;
}

// All stations together from one start each: angles free, one lens a camera.
Start Fitter::RefineAll(const std::vector<const Start*>& starts) const {
  Start all;
  all.is_closed = std::all_of(starts.begin(), starts.end(), [](const Start* s) { return s->is_closed; });
  for (size_t c = 0; c < cameras_.size(); ++c) {
    all.state.lenses.push_back({std::log(priors_[c].focal_px), DistortionOf(cameras_[c])});
  }
  std::vector<std::vector<CircularLens>> lenses = {all.state.lenses};
  for (size_t s = 0; s < starts.size(); ++s) {
    all.state.turns.push_back(starts[s]->state.turns[0]);
    lenses.push_back(lenses[0]);
    lenses.back()[static_cast<size_t>(data_[s].lens)] = starts[s]->state.lenses[0];
    if (lenses.size() > kMaxLenses) break;
  }
  for (size_t s = all.state.turns.size(); s < starts.size(); ++s)
    all.state.turns.push_back(starts[s]->state.turns[0]);
  CircularPriors priors = AllPriors(false);
  all.steps = all.is_closed ? CircularSteps::kEqualHeld : CircularSteps::kEqual;
  // One lens for all: stations that were fitted alone disagree on it, and each may be right.
  const CircularState start = all.state;
  std::vector<Start> with_lens(lenses.size());
  for (size_t k = 0; k < lenses.size(); ++k) {
    with_lens[k].state = start;
    with_lens[k].state.lenses = lenses[k];
  }
  ForEach(&with_lens, [&](Start* one) {
    one->state.sigma_px = options_.noise_px;
    RefineCircular(data_, priors, all.steps, 12, &one->state, nullptr);
    one->state.sigma_px = 0.5 * options_.noise_px;
    one->log_posterior = RefineCircular(data_, priors, all.steps, 12, &one->state, nullptr).log_posterior;
  });
  const Start* best = &with_lens[0];
  for (const Start& one : with_lens) {
    if (one.log_posterior > best->log_posterior) best = &one;
  }
  all.state = best->state;
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

  CircularState free = all.state;
  priors.angles = free.turns;
  free.sigma_px = options_.noise_px;
  RefineCircular(data_, priors, CircularSteps::kFree, 15, &free, nullptr);
  const CircularFigures freed = Settle(priors, CircularSteps::kFree, &free);
  double extra = 0;
  for (const CircularMatches& station : data_) extra += station.num_photos - 2;
  const double worth = freed.log_posterior - (extra + static_cast<double>(data_.size())) * 0.5 *
                                                 std::log(std::max(2.0, freed.inliers));
  if (worth > all.log_posterior) {
    all.log_posterior = worth;
    all.state = std::move(free);
    all.steps = CircularSteps::kFree;
  }
  return all;
}

void Fitter::Report(const CircularState& state, CircularSteps steps, CircularMotion* motion) const {
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
      fit.placed.push_back(figures.gain_of_photo[s][i] > kCertain || (!are_free && has_matches[i] != 0) ? 1
                                                                                                        : 0);
    // By the Bayesian information criterion against chance, which has no parameters.
    const double parameters = 5.0 + (are_free ? data.num_photos - 1 : steps == CircularSteps::kEqual ? 1 : 0);
    fit.found = fit.gain > 0.5 * parameters * std::log(std::max(2, fit.matches)) + kCertain &&
                std::count(fit.placed.begin(), fit.placed.end(), 1) >= 3;
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

CircularMotion Fitter::Fit() {
  CircularMotion motion;
  motion.cameras = cameras_;
  motion.focal_sigma_log.assign(cameras_.size(), 0);
  motion.distortion_is_free.assign(cameras_.size(), 0);
  motion.stations.resize(stations_.size());
  for (size_t s = 0; s < stations_.size(); ++s) {
    std::optional<CircularMatches> data = Collect(stations_[s]);
    if (!data) continue;
    reach_px_.push_back(data->reach_px);
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
      reach_px_.erase(reach_px_.begin() + static_cast<std::ptrdiff_t>(s));
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
  BindMoves(false);
  Start best = RefineAll(all_closed);
  motion.closed_log_posterior = best.log_posterior;
  BindMoves(true);
  Start other = RefineAll(all_open);
  motion.open_log_posterior = other.log_posterior;
  if (other.log_posterior > best.log_posterior) best = std::move(other);
  if (each_best != all_closed && each_best != all_open) {
    other = RefineAll(each_best);
    if (other.log_posterior > best.log_posterior) best = std::move(other);
  }
  BindMoves(!best.is_closed);

  // Distortion counts as one unknown a camera and has to be worth it.
  CircularPriors priors = AllPriors(true);
  priors.angles = best.state.turns;
  Start bent = best;
  const CircularFigures figures = Settle(priors, bent.steps, &bent.state);
  const auto num_free = std::count_if(cameras_.begin(), cameras_.end(), [](const Camera& camera) {
    return DistortionPlace(camera).has_value();
  });
  const double cost = 0.5 * static_cast<double>(num_free) * std::log(std::max(2.0, figures.inliers));
  const double straight = EvaluateCircular(data_, AllPriors(false), best.state, false).log_posterior;
  const double gain = figures.log_posterior - straight - cost;
  const bool is_free = num_free > 0 && gain > 0;
  if (is_free) {
    best = std::move(bent);
    best.log_posterior += gain;
  } else {
    priors = AllPriors(false);
    priors.angles = best.state.turns;
  }
  RefineCircular(data_, priors, best.steps, 5, &best.state, &motion.focal_sigma_log);
  motion.steps_are_equal = best.steps != CircularSteps::kFree;

  motion.log_posterior = best.log_posterior;
  motion.sigma_px = best.state.sigma_px;
  for (size_t c = 0; c < cameras_.size(); ++c) {
    Camera& camera = motion.cameras[c];
    const CameraModelInfo& info = InfoOf(camera.model);
    if (!IsPerspective(camera.model)) continue;
    const double factor = std::exp(best.state.lenses[c].log_focal) / FocalLengths(camera).x();
    for (size_t k = 0; k < info.num_focal_params; ++k) camera.params[k] *= factor;
    const std::optional<size_t> place = DistortionPlace(camera);
    if (!is_free || !place) continue;
    camera.params[*place] = best.state.lenses[c].distortion;
    motion.distortion_is_free[c] = 1;
  }
  Report(best.state, best.steps, &motion);
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
