#include "sfm_split/circular_motion/station_search.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <iterator>
#include <map>
#include <string>
#include <utility>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/circular_motion/lens_priors.h"
#include "sfm_split/circular_motion/station_matches.h"
#include "sfm_split/circular_motion/table_views.h"

namespace s2gs {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr size_t kRankMatches = 1000;          // that rank the starting points
constexpr size_t kSearchMatches = 3000;        // that these are refined with
constexpr size_t kNumFinished = 6;             // of the different optima that refined starts come to
constexpr size_t kNumWithoutParts = 2;         // of these that go on without a part of the turn ...
constexpr int kNumParts = 3;                   // ... of so many
constexpr double kOneOptimum = 4 * kPi / 180;  // between axes: half of what the starts lie apart
constexpr double kOneStep = 0.15;              // between steps, as a share: half of what the starts lie apart
// A judgement: the standard deviation of how far a camera stands below the table, which then hides the
// object.
constexpr double kBelowTable = 3 * kPi / 180;
constexpr double kUpright = 0.9;  // of photos, as they are stored; either side has half the next
// Both sides together: with the two others a judgement, as no photo should be ruled out.
constexpr double kOnTheSide = 0.045;
constexpr double kOnTheHead = 0.001;    // a judgement, likewise
constexpr double kMoreThanOnce = 0.01;  // a judgement: that a station's photos go round more than once
constexpr double kMuchMore = 1.5;       // turns: what is more than once for sure
constexpr double kCoarseNoise = 2;      // times the noise, while everything is far off

// A camera that looks down at the table, the axis behind the middle of what moves.
// \param up  of the axis in the picture.
CircularState StateOf(const CircularMatches& station, const Vector2d& middle, double focal_px,
                      double elevation, const Vector2d& up, double step) {
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

// And of how far its photos turn. Steps of n times the right one explain what repeats.
double LogPriorOfSpan(const CircularTurn& turn) {
  const double step = turn.angles.size() > 1 ? std::abs(turn.angles[1] - turn.angles[0]) : 0;
  return step * static_cast<double>(turn.angles.size()) > kMuchMore * 2 * kPi ? std::log(kMoreThanOnce) : 0;
}

void TakePriors(CircularStart* start) {
  CircularTurn* const turn = &start->state.turns[0];
  start->log_prior = PointAxisUp(turn);
  start->log_prior += LogPriorOfSpan(*turn);
  start->log_posterior += start->log_prior;
}

void SortByPosterior(std::vector<CircularStart>* starts) {
  std::stable_sort(starts->begin(), starts->end(), [](const CircularStart& a, const CircularStart& b) {
    return a.log_posterior > b.log_posterior;
  });
}

// So many at most of each view and step: which is right cannot be told before they are refined. Unrefined,
// the smallest steps explain more than a right one that is a degree off.
std::vector<CircularStart> BestOfEachView(std::vector<CircularStart> starts, int num) {
  SortByPosterior(&starts);
  std::map<std::pair<size_t, double>, int> taken;
  std::vector<CircularStart> kept;
  for (CircularStart& start : starts) {
    if (taken[{start.view, start.state.turns[0].angles[1]}]++ < num) kept.push_back(std::move(start));
  }
  return kept;
}

// The best starts that have come to different optima: a station whose perspective is weak has two at least,
// the second its mirror image, and where many starts come to the one it may be the other that is right.
std::vector<CircularStart> DifferentOptima(std::vector<CircularStart> starts, size_t num) {
  SortByPosterior(&starts);
  std::vector<CircularStart> kept;
  for (CircularStart& start : starts) {
    if (kept.size() == num) break;
    const CircularTurn& turn = start.state.turns[0];
    const bool is_new = std::none_of(kept.begin(), kept.end(), [&](const CircularStart& better) {
      const CircularTurn& other = better.state.turns[0];
      return turn.frame.col(2).dot(other.frame.col(2)) > std::cos(kOneOptimum) &&
             std::abs(turn.angles[1] - other.angles[1]) < kOneStep * std::abs(other.angles[1]);
    });
    if (is_new) kept.push_back(std::move(start));
  }
  return kept;
}

// What a search works on.
struct Searched {
  std::vector<CircularMatches> few;   // that rank starts, one entry
  std::vector<CircularMatches> many;  // that the best of them are refined with, one entry
  std::vector<CircularMatches> all;   // that these are compared with, one entry
  Vector2d middle;                    // of what moves
  CircularPriors priors;
};

std::optional<Searched> SampleStation(const CircularMatches& data, const Camera& camera,
                                      const FocalPrior& prior) {
  Searched searched;
  searched.few = {SampleMatches(data, kRankMatches)};
  searched.many = {SampleMatches(data, kSearchMatches)};
  searched.all = {data};
  searched.few[0].lens = searched.many[0].lens = searched.all[0].lens = 0;
  // Whether a turn that became next to nothing explains anything is asked when all matches are compared.
  searched.few[0].reach_px = searched.many[0].reach_px = 0;
  Vector2d middle = Vector2d::Zero();
  double num = 0;
  for (const CircularMatches::Pair& pair : searched.many[0].pairs) {
    for (const CircularMatch& match : pair.matches) {
      middle += match.first + match.second;
      num += 2;
    }
  }
  if (num == 0) return std::nullopt;
  searched.middle = middle / num;
  searched.priors = PriorsOfLenses({camera}, {prior}, false);
  return searched;
}

// Focal lengths, elevations, steps, sides that are up and senses of turning, each with each.
std::vector<CircularStart> StartsOf(const Searched& searched, bool is_closed,
                                    const CircularOptions& options) {
  std::vector<double> steps;
  for (const double degrees : {1.5, 3.0, 6.0, 10.0, 15.0, 20.0, 30.0, 40.0, 60.0, 90.0})
    steps.push_back(degrees * kDegree);
  if (is_closed) steps = {2 * kPi / searched.few[0].num_photos};
  std::vector<std::pair<Vector2d, double>> views;
  for (const Vector2d& up : UpDirections()) {
    for (const double sense : {1.0, -1.0}) views.emplace_back(up, sense);
  }
  // From what is stated, and from where it would be, were that wrong.
  const FocalPrior& prior = searched.priors.focal[0];
  const FocalNormal spread = prior.otherwise.value_or(prior.likeliest);
  std::vector<CircularStart> starts;
  for (const double factor : {-1.5, 0.0, 1.5}) {
    const double focal_px =
        factor == 0 ? prior.likeliest.focal_px : spread.focal_px * std::exp(factor * spread.sigma_log);
    for (const double elevation_deg : kElevationsDeg) {
      for (const double step : steps) {
        for (size_t view = 0; view < views.size(); ++view) {
          const auto& [up, sense] = views[view];
          CircularStart start;
          start.is_closed = is_closed;
          start.view = view;
          start.state =
              StateOf(searched.few[0], searched.middle, focal_px, elevation_deg * kDegree, up, sense * step);
          start.state.lenses[0].distortion = searched.priors.distortion[0];
          start.state.sigma_px = kCoarseNoise * options.noise_px;
          starts.push_back(std::move(start));
        }
      }
    }
  }
  return starts;
}

// Without what photos of one part of the turn say.
std::vector<CircularMatches> WithoutPart(const CircularMatches& data, int part, int num_parts) {
  const auto is_left_out = [&](int photo) { return photo * num_parts / data.num_photos == part; };
  CircularMatches rest = data;
  rest.pairs.clear();
  for (const CircularMatches::Pair& pair : data.pairs) {
    if (!is_left_out(pair.photo1) && !is_left_out(pair.photo2)) rest.pairs.push_back(pair);
  }
  rest.rows.clear();
  for (const CircularMatches::Row& row : data.rows) {
    if (std::none_of(row.photos.begin(), row.photos.end(), is_left_out)) rest.rows.push_back(row);
  }
  return {std::move(rest)};
}

// Somebody who walks by is in a few photos, and a rigid body there: what these say may hold a start where it
// is. So the best go on without a third of the turn each, too.
void AddWithoutParts(const Searched& searched, CircularSteps mode, const CircularOptions& options,
                     Reporter& reporter, std::vector<CircularStart>* starts) {
  SortByPosterior(starts);
  std::vector<CircularStart> without;
  for (size_t k = 0; k < std::min(starts->size(), kNumWithoutParts); ++k)
    without.insert(without.end(), static_cast<size_t>(kNumParts), (*starts)[k]);
  ParallelFor(static_cast<int64_t>(without.size()), 0, [&](int64_t i) {
    if (reporter.StopRequested()) throw Interrupted();
    CircularState& state = without[static_cast<size_t>(i)].state;
    state.sigma_px = options.noise_px;
    SettleCircular(WithoutPart(searched.many[0], static_cast<int>(i) % kNumParts, kNumParts), searched.priors,
                   mode, options.noise_px, &state);
  });
  std::move(without.begin(), without.end(), std::back_inserter(*starts));
}

std::optional<CircularStart> BestStart(const Searched& searched, bool is_closed,
                                       const CircularOptions& options, Reporter& reporter,
                                       size_t* num_tried) {
  const CircularPriors& priors = searched.priors;
  std::vector<CircularStart> starts = StartsOf(searched, is_closed, options);
  *num_tried += starts.size();
  ForEachStart(&starts, reporter, [&](CircularStart* start) {
    start->log_posterior = EvaluateCircular(searched.few, priors, start->state, false).log_posterior;
  });
  starts = BestOfEachView(std::move(starts), is_closed ? options.num_refined : 1);
  const CircularSteps mode = is_closed ? CircularSteps::kEqualHeld : CircularSteps::kEqual;
  ForEachStart(&starts, reporter, [&](CircularStart* start) {
    RefineCircular(searched.few, priors, mode, 12, &start->state, nullptr);
    start->state.sigma_px = options.noise_px;
    start->log_posterior =
        RefineCircular(searched.few, priors, mode, 8, &start->state, nullptr).log_posterior;
    TakePriors(start);
  });
  starts = DifferentOptima(std::move(starts), kNumFinished);
  // Steps that close are not next to nothing.
  std::vector<CircularMatches> all = searched.all;
  if (is_closed) all[0].reach_px = 0;
  ForEachStart(&starts, reporter, [&](CircularStart* start) {
    start->state.sigma_px = 0.5 * options.noise_px;
    start->log_posterior =
        RefineCircular(searched.many, priors, mode, 15, &start->state, nullptr).log_posterior;
  });
  AddWithoutParts(searched, mode, options, reporter, &starts);
  ForEachStart(&starts, reporter, [&](CircularStart* start) {
    const CircularFigures equal = SettleCircular(all, priors, mode, options.noise_px, &start->state);
    CircularState free = start->state;
    const double charge = is_closed ? 0 : 0.5 * std::log(std::max(2.0, equal.inliers));
    start->log_posterior = equal.log_posterior - charge;
    // Of steps that are not equal at all, equal ones say little.
    const double freed = FreeCircularAngles(all, priors, options.noise_px, &free);
    if (freed > start->log_posterior + kBeyondChance) start->log_posterior = freed;
    TakePriors(start);
  });
  std::optional<CircularStart> best;
  for (CircularStart& start : starts) {
    if (!best || start.log_posterior > best->log_posterior) best = std::move(start);
  }
  reporter.Debug(std::string(is_closed ? "closed" : "open") + ": log-likelihood " +
                 std::to_string(best->log_posterior) + ", step " +
                 std::to_string(best->state.turns[0].angles[1] / kDegree) + ", focal length " +
                 std::to_string(std::exp(best->state.lenses[0].log_focal)));
  return best;
}

}  // namespace

StationStarts SearchStation(const CircularMatches& data, const Camera& camera, const FocalPrior& prior,
                            const CircularOptions& options, Reporter& reporter) {
  const std::optional<Searched> searched = SampleStation(data, camera, prior);
  if (!searched) return {};
  StationStarts starts;
  starts.closed = BestStart(*searched, true, options, reporter, &starts.num_tried);
  starts.open = BestStart(*searched, false, options, reporter, &starts.num_tried);
  return starts;
}

}  // namespace s2gs
