#include "sfm_split/relocalise/station_turns.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <string>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/infinity.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/relocalise/match_ascent.h"
#include "sfm_split/relocalise/match_likelihood.h"
#include "sfm_split/relocalise/station_witnesses.h"

namespace s2gs {
namespace {

constexpr AscentNoise kFirstNoise = {1, 1};  // [px] object, background; the rounds correct it
constexpr int kNoiseRounds = 4;              // a judgement: noise and state by turns
constexpr int kMaxSteps = 40;                // of a climb
constexpr size_t kLeastOfStation = 4;        // photos that are a turn
constexpr size_t kSearchMatches = 6000;      // that find other turns; all decide
constexpr double kSearchStep = 1;            // of the noise, as the object's points move
constexpr double kCertain = 8;               // e^8 to one
// What is asked of a table angle; the others lead there.
constexpr std::array<double, 3> kTurnsDeg = {0.25, 0.5, 1};

class Asker {
 public:
  Asker(const MatchAscent& top, const AscentNoise& noise, Reporter& reporter)
      : top_(top), noise_(noise), reporter_(reporter), value_(top.Value(noise)) {}

  // How much less likely the last of the turns is, to the side where that is least.
  double Drop(size_t station, size_t reference) const {
    double least = kInfinity;
    for (const double side : {-1.0, 1.0}) {
      MatchAscent turned = top_;
      turned.HoldTurns({reference, station});
      double value = value_;
      double before_deg = 0;
      for (const double turn_deg : kTurnsDeg) {
        MatchAscent::State state = turned.state();
        state.stations[station].turn_rad += side * (turn_deg - before_deg) * kDegree;
        before_deg = turn_deg;
        turned.SetState(std::move(state));
        value = turned.Climb(noise_, kMaxSteps, reporter_);
      }
      least = std::min(least, value_ - value);
    }
    return least;
  }

  // The same at the likeliest turn a degree away or farther that a climb leads to and stays at.
  double DropElsewhere(size_t station, size_t reference) const {
    MatchAscent search = top_;
    search.Thin(kSearchMatches);
    double least = kInfinity;
    const double here = Turn(top_, station, reference);
    for (const double turn_rad : search.TurnsAlone(station, noise_.object, kSearchStep * noise_.object)) {
      if (std::abs(turn_rad) < kTurnsDeg.back() * kDegree) continue;
      MatchAscent turned = top_;
      // A camera that may turn about the axis would undo the turn, and be where it was.
      if (!turned.HasBackground()) turned.HoldTurns({reference, station});
      MatchAscent::State state = turned.state();
      state.stations[station].turn_rad += turn_rad;
      turned.SetState(std::move(state));
      const double value = turned.Climb(noise_, kMaxSteps, reporter_);
      if (std::abs(WrapAngle(Turn(turned, station, reference) - here)) < kTurnsDeg.back() * kDegree) continue;
      least = std::min(least, value_ - value);
    }
    return least;
  }

 private:
  static double Turn(const MatchAscent& ascent, size_t station, size_t reference) {
    return ascent.state().stations[station].turn_rad - ascent.state().stations[reference].turn_rad;
  }

  const MatchAscent& top_;
  const AscentNoise noise_;
  Reporter& reporter_;
  const double value_;
};

}  // namespace

StationTurns AskStationTurns(const ScanFeatures& features, const std::vector<PossiblePair>& object_pairs,
                             const AlignedScene& aligned, Reporter& reporter) {
  StationTurns result;
  const View* const reference = aligned.scene.Reference();
  if (reference == nullptr) return result;
  std::map<int, size_t> photos;
  for (const View& view : aligned.scene.views) ++photos[view.station];
  // Of photos that each have a station of their own no turns are asked, and no steps.
  if (photos.size() == aligned.scene.views.size()) return result;
  MatchAscent ascent(features, StationWitnesses(features, aligned, object_pairs), aligned);
  if (!ascent.HasStations()) return result;
  AscentNoise noise = kFirstNoise;
  for (int k = 0; k < kNoiseRounds; ++k) noise = ascent.NoiseBy(noise);
  const MatchAscent posed = ascent;
  noise = ascent.Settle(noise, reporter);
  const double below = ascent.Climb(noise, kMaxSteps, reporter) - posed.Value(noise);
  result.overdispersion = std::max(1.0, 2 * below / std::max(1, ascent.NumTold()));
  const Asker asker(ascent, noise, reporter);
  const auto of_reference = static_cast<size_t>(ascent.PlaceOf(reference->station));
  for (const auto& [station, count] : photos) {
    if (station == reference->station || count < kLeastOfStation) continue;
    const auto place = static_cast<size_t>(ascent.PlaceOf(station));
    const double drop = asker.Drop(place, of_reference) / result.overdispersion;
    const bool is_told =
        drop > 0 && asker.DropElsewhere(place, of_reference) > kCertain * result.overdispersion;
    // A normal distribution's logarithm falls by half its square.
    result.sigma_deg[station] = is_told ? kTurnsDeg.back() / std::sqrt(2 * drop) : kInfinity;
  }
  return result;
}

void WidenByTurns(const TurntableScene& scene, const StationTurns& turns, JointReport* joint) {
  for (size_t v = 0; v < scene.views.size() && v < joint->angle_sigma_deg.size(); ++v) {
    const auto found = turns.sigma_deg.find(scene.views[v].station);
    double& sigma_deg = joint->angle_sigma_deg[v];
    if (found != turns.sigma_deg.end() && sigma_deg > 0) sigma_deg = std::max(sigma_deg, found->second);
  }
}

MatchFindings AskMatches(const ScanFeatures& features, const std::vector<PossiblePair>& object_pairs,
                         const AlignedScene& aligned, const std::map<int, double>& told_otherwise_deg,
                         Reporter& reporter, JointReport* joint) {
  MatchFindings findings;
  findings.noise_px = LikelihoodOfMatches(features, aligned, object_pairs).sigma_px;
  if (joint->model != JointModel::kSharedStations) return findings;
  StationTurns turns = AskStationTurns(features, object_pairs, aligned, reporter);
  findings.overdispersion = turns.overdispersion;
  for (const auto& [station, sigma_deg] : turns.sigma_deg) {
    reporter.Debug("all matches tell station " + std::to_string(station) + "'s turn to " +
                   std::to_string(sigma_deg) + " degrees; their logarithms are " +
                   std::to_string(turns.overdispersion) + " times too large");
  }
  for (auto& [station, sigma_deg] : turns.sigma_deg) {
    const auto told = told_otherwise_deg.find(station);
    if (told != told_otherwise_deg.end()) sigma_deg = std::min(sigma_deg, told->second);
  }
  findings.turn_sigma_deg = turns.sigma_deg;
  WidenByTurns(aligned.scene, turns, joint);
  return findings;
}

}  // namespace s2gs
