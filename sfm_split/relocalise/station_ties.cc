#include "sfm_split/relocalise/station_ties.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <vector>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/error.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/scene/axis_turn.h"

namespace s2gs {
namespace {

// Of the best angle's support: a station that has as much where it stands stays there.
constexpr double kStaySupport = 0.9;
// Of the matches: a station that so many support where it stands is right, whatever other angles they allow.
constexpr double kStayShare = 0.6;
// Raw matches: how often chance may tie one station, and how much less likely any other angle is (e^8).
constexpr double kMaxChance = 1e-2;
constexpr double kCertain = 8;
constexpr int kChanceTurns = 72;         // at which chance's support is looked at,
constexpr double kChanceShare = 0.9;     // of whose supports it is this quantile
constexpr size_t kMaxRawMatches = 2000;  // of a pair of stations

class Tier {
 public:
  Tier(int num_stations, const TurntableAxis& axis, const std::vector<StationMatches>& pairs,
       const TieOptions& options)
      : axis_(axis), pairs_(pairs), options_(options), ties_(static_cast<size_t>(num_stations)) {
    for (int s = 0; s < num_stations; ++s) ties_[static_cast<size_t>(s)].component = -1;
    fits_.resize(ties_.size());
  }

  std::vector<StationTie> Run(int root) {
    for (int next = root; next >= 0; next = FirstUntied()) {
      ties_[static_cast<size_t>(next)].component = next;
      for (Fit& fit : fits_) fit = Fit();
      Refit(next, next);
      for (int best = BestFit(); best >= 0; best = BestFit()) {
        const Fit& fit = fits_[static_cast<size_t>(best)];
        ties_[static_cast<size_t>(best)] = {next,        fit.turn_rad, fit.inliers,
                                            fit.matches, fit.margin,   fit.is_raw};
        Refit(best, next);
      }
    }
    return ties_;
  }

 private:
  struct Fit {
    bool is_good = false;
    bool is_raw = false;
    double turn_rad = 0;
    int inliers = 0;
    int matches = 0;
    double margin = 0;
  };

  int FirstUntied() const {
    for (size_t s = 0; s < ties_.size(); ++s) {
      if (ties_[s].component < 0) return static_cast<int>(s);
    }
    return -1;
  }

  static bool IsBetter(const Fit& a, const Fit& b) {
    return a.is_raw != b.is_raw ? b.is_raw : a.inliers > b.inliers;
  }

  int BestFit() const {
    int best = -1;
    for (size_t s = 0; s < fits_.size(); ++s) {
      if (ties_[s].component >= 0 || !fits_[s].is_good) continue;
      if (best < 0 || IsBetter(fits_[s], fits_[static_cast<size_t>(best)])) best = static_cast<int>(s);
    }
    return best;
  }

  // The matches of a station with those of a component, the latter in their turned places.
  std::vector<MatchAcrossTurn> MatchesWith(int station, int component, bool verified) const {
    std::vector<MatchAcrossTurn> all;
    const size_t most = verified ? static_cast<size_t>(std::max(1, options_.max_matches)) : kMaxRawMatches;
    for (const StationMatches& pair : pairs_) {
      if (pair.are_verified != verified) continue;
      const bool is_first = pair.station == station;
      if (!is_first && pair.other_station != station) continue;
      const StationTie& other = ties_[static_cast<size_t>(is_first ? pair.other_station : pair.station)];
      if (other.component != component) continue;
      const Rigid3 turned = TurnAbout(axis_, other.turn_rad);
      const size_t stride = 1 + pair.matches.size() / most;
      for (size_t k = 0; k < pair.matches.size(); k += stride) {
        MatchAcrossTurn match = pair.matches[k];
        if (!is_first) {
          std::swap(match.camera, match.other_camera);
          std::swap(match.cam_from_world, match.other_cam_from_object);
          std::swap(match.xy, match.other_xy);
        }
        match.other_cam_from_object = match.other_cam_from_object * turned;
        all.push_back(match);
      }
    }
    return all;
  }

  // Fits the stations that have matches with one that was tied just now.
  void Refit(int tied, int component) {
    for (const StationMatches& pair : pairs_) {
      if (pair.station != tied && pair.other_station != tied) continue;
      const int station = pair.station == tied ? pair.other_station : pair.station;
      if (ties_[static_cast<size_t>(station)].component >= 0) continue;
      Fit& fit = fits_[static_cast<size_t>(station)];
      fit = FitStation(MatchesWith(station, component, true));
      if (!fit.is_good) fit = FitRaw(MatchesWith(station, component, false));
    }
  }

  Fit FitStation(const std::vector<MatchAcrossTurn>& matches) const {
    Fit result;
    result.matches = static_cast<int>(matches.size());
    const double least = std::max(static_cast<double>(options_.min_inliers),
                                  options_.min_share * static_cast<double>(matches.size()));
    const TurnSupport here = SupportOfTurn(axis_, matches, options_.max_error_px, 0);
    const TableAngleFit fit = FitTurn(axis_, matches, options_.max_error_px, options_.min_inliers);
    result.margin = fit.margin;
    if (here.inliers >= least && here.score >= kStaySupport * fit.support) {
      result.inliers = here.inliers;
      result.is_good = fit.margin >= options_.min_margin ||
                       here.inliers >= kStayShare * static_cast<double>(matches.size());
      return result;
    }
    result.is_good = fit.found && fit.inliers >= least && fit.margin >= options_.min_margin;
    result.inliers = fit.inliers;
    result.turn_rad = fit.angle_rad;
    return result;
  }

  // The angle that more matches support than chance explains at any, and far more than at any other.
  Fit FitRaw(const std::vector<MatchAcrossTurn>& matches) const {
    Fit result;
    result.is_raw = true;
    result.matches = static_cast<int>(matches.size());
    if (result.matches < options_.min_inliers) return result;
    const TableAngleFit fit = FitTurn(axis_, matches, options_.max_error_px, options_.min_inliers);
    if (!fit.found) return result;
    std::vector<int> supports;
    for (int k = 0; k < kChanceTurns; ++k) {
      const double turn_rad = fit.angle_rad + kPi * (2 * k + 1) / kChanceTurns;
      supports.push_back(SupportOfTurn(axis_, matches, options_.max_error_px, turn_rad).inliers);
    }
    const double chance = std::max(1, Quantile(supports, kChanceShare));
    const double log_chance = LogPoissonTail(fit.inliers, chance);
    const int others = static_cast<int>(std::ceil(fit.inliers / std::max(1.0, fit.margin)));
    // Every match proposes two angles.
    const double log_false_alarms = std::log(2.0 * result.matches) + log_chance;
    result.is_good =
        log_false_alarms <= std::log(kMaxChance) && LogPoissonTail(others, chance) - log_chance >= kCertain;
    result.inliers = fit.inliers;
    result.margin = fit.margin;
    const TurnSupport here = SupportOfTurn(axis_, matches, options_.max_error_px, 0);
    result.turn_rad = here.score >= kStaySupport * fit.support ? 0 : fit.angle_rad;
    return result;
  }

  const TurntableAxis& axis_;
  const std::vector<StationMatches>& pairs_;
  const TieOptions& options_;
  std::vector<StationTie> ties_;
  std::vector<Fit> fits_;
};

}  // namespace

std::vector<StationTie> TieStations(int num_stations, int root, const TurntableAxis& axis,
                                    const std::vector<StationMatches>& pairs, const TieOptions& options) {
  S2GS_INVARIANT(root >= 0 && root < num_stations);
  return Tier(num_stations, axis, pairs, options).Run(root);
}

}  // namespace s2gs
