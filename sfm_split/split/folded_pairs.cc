#include "sfm_split/split/folded_pairs.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <string>
#include <utility>

#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/statistics.h"
#include "sfm_split/split/station_turn.h"

namespace s2gs {
namespace {

constexpr int kCloseSteps = 3;         // between photos that show how the table turns
constexpr double kMinTurnShare = 0.7;  // of their matches that must follow one turn

// How the table turns before each station, and which pairs do not follow.
class FoldedPairs {
 public:
  FoldedPairs(const SplitMatching& matching, const Stations& stations,
              const std::vector<std::vector<int>>& order, const std::vector<VerifiedPair>& pairs)
      : matching_(matching),
        stations_(stations),
        pairs_(pairs),
        max_error_px_(matching.settings().motion.max_error_px),
        place_(matching.images().size()),
        pairs_of_station_(stations.images.size()),
        turns_(stations.images.size()) {
    for (const std::vector<int>& station : order) {
      for (size_t p = 0; p < station.size(); ++p) place_[station[p]] = static_cast<int>(p);
    }
    for (const VerifiedPair& pair : pairs) {
      pairs_of_station_[stations.station_of_image[pair.image1]].push_back(&pair);
    }
  }

  void FitTurns() {
    const auto count = static_cast<int64_t>(turns_.size());
    ParallelFor(count, 0, [&](int64_t s) { Fit(static_cast<size_t>(s), std::nullopt); });
    // What stations know that were turned all around holds for the others.
    std::vector<double> focals;
    for (const std::optional<StationTurn>& turn : turns_) {
      if (turn && turn->is_full_turn) focals.push_back(turn->focal_px);
    }
    if (focals.empty() || !HaveOneSize()) return;
    const double focal_px = UpperMedian(focals);
    ParallelFor(count, 0, [&](int64_t s) {
      if (!turns_[s] || !turns_[s]->is_full_turn) Fit(static_cast<size_t>(s), focal_px);
    });
  }

  // Per pair.
  std::vector<uint8_t> AreFolded() const {
    std::vector<uint8_t> is_folded(pairs_.size(), 0);
    ParallelFor(static_cast<int64_t>(turns_.size()), 0, [&](int64_t s) {
      if (!turns_[s]) return;
      for (const VerifiedPair* pair : pairs_of_station_[s]) {
        if (FitsItsAngle(*turns_[s], ToTurn(*pair), max_error_px_)) continue;
        is_folded[static_cast<size_t>(pair - pairs_.data())] = 1;
      }
    });
    return is_folded;
  }

 private:
  void Fit(size_t s, std::optional<double> focal_px) {
    const auto num_photos = static_cast<int>(stations_.images[s].size());
    std::vector<TurnMatches> close;
    for (const VerifiedPair* pair : pairs_of_station_[s]) {
      const int steps = std::abs(place_[pair->image2] - place_[pair->image1]);
      if (std::min(steps, num_photos - steps) <= kCloseSteps) close.push_back(ToTurn(*pair));
    }
    turns_[s] = FitStationTurn(close, num_photos, matching_.sizes()[stations_.images[s].front()],
                               max_error_px_, kMinTurnShare, focal_px);
  }

  TurnMatches ToTurn(const VerifiedPair& pair) const {
    TurnMatches matches;
    matches.steps = place_[pair.image2] - place_[pair.image1];
    matches.xy1.reserve(pair.matches.size());
    matches.xy2.reserve(pair.matches.size());
    for (const FeatureMatch& match : pair.matches) {
      matches.xy1.push_back(ToFirst(pair.image1, matching_.keypoints()[pair.image1][match.point2D_idx1]));
      matches.xy2.push_back(ToFirst(pair.image2, matching_.keypoints()[pair.image2][match.point2D_idx2]));
    }
    return matches;
  }

  // Where the station's first photo would show the same ray.
  Eigen::Vector2f ToFirst(int image, const Eigen::Vector2f& xy) const {
    return stations_.Move(image, stations_.images[stations_.station_of_image[image]].front(), xy);
  }

  bool HaveOneSize() const {
    return std::all_of(matching_.sizes().begin(), matching_.sizes().end(),
                       [&](const Eigen::Vector2i& size) { return size == matching_.sizes().front(); });
  }

  const SplitMatching& matching_;
  const Stations& stations_;
  const std::vector<VerifiedPair>& pairs_;
  double max_error_px_;
  std::vector<int> place_;  // of each photo in its station's order
  std::vector<std::vector<const VerifiedPair*>> pairs_of_station_;
  std::vector<std::optional<StationTurn>> turns_;  // per station
};

}  // namespace

void RemoveFoldedPairs(const SplitMatching& matching, const Stations& stations,
                       const std::vector<std::vector<int>>& order, std::vector<VerifiedPair>* object_pairs) {
  FoldedPairs folded(matching, stations, order, *object_pairs);
  folded.FitTurns();
  const std::vector<uint8_t> is_folded = folded.AreFolded();
  std::vector<VerifiedPair> kept;
  kept.reserve(object_pairs->size());
  for (size_t p = 0; p < is_folded.size(); ++p) {
    if (is_folded[p] == 0) kept.push_back(std::move((*object_pairs)[p]));
  }
  const size_t num_folded = object_pairs->size() - kept.size();
  if (num_folded > 0) {
    matching.reporter().Debug(std::to_string(num_folded) + " pairs show a wrong angle: taken out");
  }
  *object_pairs = std::move(kept);
}

}  // namespace s2gs
