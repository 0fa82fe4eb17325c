#include "sfm_split/circular_motion/circular_ties.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numeric>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/circular_motion/climb.h"
#include "sfm_split/circular_motion/epipolar_gain.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr double kGrid = 1.5 * kDegree;     // of turns
constexpr double kCoarseSigmaPx = 4;        // between places of the grid
constexpr double kDistinct = 15 * kDegree;  // turns farther apart are two answers: ten places of the grid
constexpr double kCertain = 8;              // e^-8: what is believed against chance, and against another mode
constexpr size_t kCoarseMatches = 3000;     // evenly chosen, that rank the places of the grid
constexpr int kNumRefined = 8;              // best places of the grid
constexpr int64_t kPlacesAtOnce = 16;       // of the grid, by one thread
constexpr int64_t kPairsAtOnce = 2;         // likewise: some .01 ms
constexpr double kFirstStep = 0.005;        // of the last climb, at all matches
constexpr double kLastStep = 1e-5;          // likewise, where it ends: .0006 degrees, a judgement
constexpr double kBestStep = kFirstStep / 8;  // from here on the best place alone climbs on

double GainOf(const CrossingPair& pair, const CircularPlace& place, double sigma_px) {
  return EpipolarGain(pair.matches, CamFromObject(pair.view, place) * pair.cam_from_object.Inverse(),
                      pair.placed_focal_px, pair.focal_px, sigma_px);
}

// From several threads, unless it is called in a loop. The sum is that of one thread.
// \param stride  every so many pairs count: of a few matches of each, nobody knows which are right.
double Gain(const std::vector<CrossingPair>& pairs, const CircularPlace& place, double sigma_px,
            size_t stride) {
  std::vector<double> gains((pairs.size() + stride - 1) / stride);
  ParallelFor(static_cast<int64_t>(gains.size()), 0, kPairsAtOnce, [&](int64_t g) {
    const auto at = static_cast<size_t>(g);
    gains[at] = GainOf(pairs[at * stride], place, sigma_px);
  });
  return std::accumulate(gains.begin(), gains.end(), 0.0);
}

// Distance, height and turn to the top of the likelihood.
double Refine(const std::vector<CrossingPair>& pairs, double sigma_px, size_t stride, double first_step,
              double last_step, CircularPlace* place) {
  const auto moved = [](CircularPlace there, size_t number, double step) {
    if (number == 0) there.distance *= std::exp(step);
    if (number == 1) there.height += step;
    if (number == 2) there.turn_rad += step;
    return there;
  };
  const auto value = [&](const CircularPlace& there) { return Gain(pairs, there, sigma_px, stride); };
  return Climb(3, first_step, last_step, moved, value, place);
}

}  // namespace

Rigid3 CamFromObject(const CircularView& view, const CircularPlace& place) {
  const Matrix3d turn = RotationAbout<double>(Vector3d::UnitZ(), view.angle_rad + place.turn_rad);
  const Matrix3d rotation = view.cam_from_axis * turn;
  return {Eigen::Quaterniond(rotation), -(view.cam_from_axis * Vector3d(place.distance, 0, place.height))};
}

CircularTie TieCircularStation(const std::vector<CrossingPair>& pairs, const CircularPlace& start,
                               double sigma_px) {
  CircularTie tie;
  size_t total = 0;
  for (const CrossingPair& pair : pairs) total += pair.matches.size();
  if (total == 0) return tie;
  const size_t stride = 1 + total / kCoarseMatches;
  std::vector<std::pair<double, CircularPlace>> places;
  for (double turn = -kPi; turn < kPi; turn += kGrid) {
    for (const double distance : {0.85, 1.0, 1.18}) {
      for (const double height : {-0.15, 0.0, 0.15}) {
        const CircularPlace place{start.distance * distance, start.height + height * start.distance, turn};
        places.emplace_back(0, place);
      }
    }
  }
  ParallelFor(static_cast<int64_t>(places.size()), 0, kPlacesAtOnce, [&](int64_t i) {
    auto& [gain, place] = places[static_cast<size_t>(i)];
    gain = Gain(pairs, place, kCoarseSigmaPx, stride);
  });
  std::stable_sort(places.begin(), places.end(),
                   [](const auto& a, const auto& b) { return a.first > b.first; });
  // The best, each in a part of the circle of its own.
  std::vector<std::pair<double, CircularPlace>> modes;
  for (const auto& candidate : places) {
    if (static_cast<int>(modes.size()) == kNumRefined) break;
    const bool is_new = std::all_of(modes.begin(), modes.end(), [&](const auto& mode) {
      return std::abs(WrapAngle(mode.second.turn_rad - candidate.second.turn_rad)) > kDistinct / 2;
    });
    if (is_new) modes.push_back(candidate);
  }
  // All pairs of one place keep all threads busy; of a few places, one of which may climb a hundred times as
  // long as another, most threads would wait for the last.
  for (auto& [gain, place] : modes) {
    Refine(pairs, kCoarseSigmaPx, stride, 0.05, 0.003, &place);
    gain = Refine(pairs, 2 * sigma_px, stride, 0.01, 0.001, &place);
  }
  std::stable_sort(modes.begin(), modes.end(),
                   [](const auto& a, const auto& b) { return a.first > b.first; });
  for (auto& [gain, place] : modes) gain = Refine(pairs, sigma_px, 1, kFirstStep, kBestStep, &place);
  modes[0].first = Refine(pairs, sigma_px, 1, kBestStep, kLastStep, &modes[0].second);
  tie.place = modes[0].second;
  tie.gain = modes[0].first;
  tie.margin = tie.gain;
  for (const auto& [gain, place] : modes) {
    if (std::abs(WrapAngle(place.turn_rad - tie.place.turn_rad)) <= kDistinct) continue;
    tie.margin = std::min(tie.margin, tie.gain - gain);
  }
  tie.place.turn_rad = WrapAngle(tie.place.turn_rad);
  tie.found = tie.gain > 1.5 * std::log(static_cast<double>(total)) + kCertain && tie.margin > kCertain;
  return tie;
}

}  // namespace s2gs
