#include "sfm_split/circular_motion/station_matches.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "sfm_split/base/parallel_for.h"
#include "sfm_split/circular_motion/match_mixture.h"
#include "sfm_split/circular_motion/turn_reach.h"
#include "sfm_split/circular_motion/wrong_matches.h"

namespace s2gs {
namespace {

using Eigen::Vector2d;

constexpr size_t kMinMatches = 30;  // of a station
constexpr int kSearchSteps = 3;     // between the photos of the pairs in the search, around the circle

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
  ParallelFor(static_cast<int64_t>(data->pairs.size()), 0, [&](int64_t p) {
    CircularMatches::Pair& pair = data->pairs[static_cast<size_t>(p)];
    for (CircularMatch& match : pair.matches) match.chance = wrong.Chance(move_of(pair, match));
  });
}

}  // namespace

bool IsPerspective(CameraModelId model) {
  return model == CameraModelId::kSimplePinhole || model == CameraModelId::kPinhole ||
         model == CameraModelId::kSimpleRadial || model == CameraModelId::kRadial ||
         model == CameraModelId::kOpenCV || model == CameraModelId::kFullOpenCV;
}

std::optional<CircularMatches> MatchesOfStation(const CircularStation& station, const Camera& camera,
                                                const CircularOptions& options, std::mt19937* rng) {
  if (station.num_photos < options.min_photos || !IsPerspective(camera.model)) return std::nullopt;
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
    std::shuffle(pair.matches.begin(), pair.matches.end(), *rng);
    if (pair.matches.size() > static_cast<size_t>(options.max_matches))
      pair.matches.resize(static_cast<size_t>(options.max_matches));
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

CircularMatches SampleMatches(const CircularMatches& all, size_t num) {
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

}  // namespace s2gs
