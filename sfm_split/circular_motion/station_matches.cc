#include "sfm_split/circular_motion/station_matches.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include "sfm_split/base/parallel_for.h"
#include "sfm_split/circular_motion/match_mixture.h"
#include "sfm_split/circular_motion/match_triples.h"
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

std::vector<CircularMatches::Row> RowsOf(const CircularStation& station, const Vector2d& middle,
                                         const Vector2d& aspect) {
  std::vector<CircularMatches::Row> rows;
  std::vector<MiddleMove> middles;
  for (const CircularRow& given : station.rows) {
    CircularMatches::Row& row = rows.emplace_back();
    row.photos = given.photos;
    for (const auto& xy : given.triples) {
      CircularTriple& triple = row.triples.emplace_back();
      for (size_t k = 0; k < 3; ++k) triple.xy[k] = (xy[k] - middle).cwiseProduct(aspect);
      middles.push_back(MiddleOf(triple.xy));
    }
  }
  const WrongMiddles wrong(middles);
  for (CircularMatches::Row& row : rows) {
    for (CircularTriple& triple : row.triples) triple.chance = wrong.Chance(MiddleOf(triple.xy));
  }
  return rows;
}

template <typename Match>
void ShuffleAndCut(int most, std::mt19937* rng, std::vector<Match>* matches) {
  std::shuffle(matches->begin(), matches->end(), *rng);
  if (matches->size() > static_cast<size_t>(most)) matches->resize(static_cast<size_t>(most));
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
    ShuffleAndCut(options.max_matches, rng, &pair.matches);
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
  result.rows = RowsOf(station, middle, aspect);
  for (CircularMatches::Row& row : result.rows) ShuffleAndCut(options.max_matches, rng, &row.triples);
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
  sample.rows.clear();
  for (const CircularMatches::Row& row : all.rows) {
    CircularMatches::Row some{row.photos, {}};
    for (const CircularTriple& triple : row.triples) {
      if (at++ % stride == 0) some.triples.push_back(triple);
    }
    if (!some.triples.empty()) sample.rows.push_back(std::move(some));
  }
  return sample;
}

}  // namespace s2gs
