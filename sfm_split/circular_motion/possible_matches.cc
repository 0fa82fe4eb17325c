#include "sfm_split/circular_motion/possible_matches.h"

#include <algorithm>
#include <cstdlib>
#include <map>
#include <utility>

#include "sfm_split/base/parallel_for.h"
#include "sfm_split/circular_motion/match_mixture.h"
#include "sfm_split/circular_motion/turn_reach.h"

namespace s2gs {
namespace {

constexpr size_t kMaxMatches = 60;  // of a pair, evenly

FeatureMatches EvenChoice(const FeatureMatches& all) {
  FeatureMatches chosen;
  const size_t stride = 1 + all.size() / (kMaxMatches + 1);
  for (size_t m = 0; m < all.size(); m += stride) chosen.push_back(all[m]);
  return chosen;
}

void AddTo(const ScanFeatures& features, const PossiblePair& pair, KeypointExtent* extent) {
  for (const FeatureMatch& match : pair.matches) {
    extent->Add(
        features.images[static_cast<size_t>(pair.image1)].keypoints[match.point2D_idx1].cast<double>());
    extent->Add(
        features.images[static_cast<size_t>(pair.image2)].keypoints[match.point2D_idx2].cast<double>());
  }
}

struct StepsApart {
  PossiblePair pair;
  int steps = 0;  // between the photos, around their station's circle; 0: of two stations
};

// What a station's matches sweep [px].
double Swept(const ScanFeatures& features, const std::vector<StepsApart>& pairs) {
  std::vector<float> x;
  std::vector<float> y;
  for (const StepsApart& apart : pairs) {
    const Keypoints& keypoints = features.images[static_cast<size_t>(apart.pair.image1)].keypoints;
    for (const FeatureMatch& match : apart.pair.matches) {
      x.push_back(keypoints[match.point2D_idx1].x());
      y.push_back(keypoints[match.point2D_idx1].y());
    }
  }
  return SweptPx(std::move(x), std::move(y));
}

}  // namespace

MatchMove MoveOf(const ScanFeatures& features, int image1, int image2, const FeatureMatch& match,
                 const Eigen::Vector2d& turn) {
  const Eigen::Vector2f px = features.images[static_cast<size_t>(image2)].keypoints[match.point2D_idx2] -
                             features.images[static_cast<size_t>(image1)].keypoints[match.point2D_idx1];
  return {px.cast<double>(), turn};
}

std::vector<PossiblePair> PossibleObjectPairs(const ScanFeatures& features, bool within_stations) {
  std::map<int, int> size_of_station;
  std::vector<int> place;
  for (const ScanImage& image : features.images) place.push_back(size_of_station[image.station]++);
  const auto move_of = [&](const PossiblePair& pair, const FeatureMatch& match) {
    const auto i = static_cast<size_t>(pair.image1);
    const int num_photos = size_of_station.at(features.images[i].station);
    return MoveOf(features, pair.image1, pair.image2, match,
                  TurnBetween(place[i], place[static_cast<size_t>(pair.image2)], num_photos));
  };
  std::map<int, std::vector<StepsApart>> pairs_of;  // by station; -1: of two stations
  KeypointExtent extent;
  for (const ImagePairMatches& given : AllPairs(features)) {
    const auto i = static_cast<size_t>(given.image1);
    const auto j = static_cast<size_t>(given.image2);
    const int station = features.images[i].station;
    const bool same_station = station == features.images[j].station;
    if (within_stations && !same_station) continue;
    StepsApart apart{
        {given.image1, given.image2, EvenChoice(PossibleObjectMatches(features, given)), {}, 0, {}}, 0};
    if (same_station) {
      const int steps = std::abs(place[i] - place[j]);
      apart.steps = std::min(steps, size_of_station[station] - steps);
    }
    AddTo(features, apart.pair, &extent);
    if (!apart.pair.matches.empty()) pairs_of[same_station ? station : -1].push_back(std::move(apart));
  }
  std::vector<PossiblePair> result;
  for (auto& [station, pairs] : pairs_of) {
    size_t total = 0;
    for (const StepsApart& apart : pairs) total += apart.pair.matches.size();
    std::stable_sort(pairs.begin(), pairs.end(),
                     [](const StepsApart& a, const StepsApart& b) { return a.steps > b.steps; });
    std::vector<MatchMove> moves;
    for (const StepsApart& apart : pairs) {
      if (station < 0 || static_cast<double>(moves.size()) > kFarShare * static_cast<double>(total)) break;
      for (const FeatureMatch& match : apart.pair.matches) moves.push_back(move_of(apart.pair, match));
    }
    const WrongMatches wrong(moves, extent.Px());
    const double reach_px = station < 0 ? 0 : kMagnification * Swept(features, pairs);
    ParallelFor(static_cast<int64_t>(pairs.size()), 0, [&, &of_station = pairs](int64_t p) {
      PossiblePair& pair = of_station[static_cast<size_t>(p)].pair;
      for (const FeatureMatch& match : pair.matches)
        pair.chance.push_back(wrong.Chance(move_of(pair, match)));
      pair.reach_px = reach_px;
    });
    for (StepsApart& apart : pairs) result.push_back(std::move(apart.pair));
  }
  return result;
}

std::vector<PossiblePair> PossibleBackgroundPairs(const ScanFeatures& features) {
  const bool has_raw = !features.raw_static_pairs.empty();
  std::vector<PossiblePair> result;
  KeypointExtent extent;
  for (const ImagePairMatches& given : has_raw ? features.raw_static_pairs : features.static_pairs) {
    result.push_back({given.image1, given.image2, given.matches, {}, 0, {}});
    AddTo(features, result.back(), &extent);
  }
  for (PossiblePair& pair : result) pair.chance.assign(pair.matches.size(), 1 / extent.Px());
  return result;
}

}  // namespace s2gs
