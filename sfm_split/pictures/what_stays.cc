#include "sfm_split/pictures/what_stays.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "sfm_split/base/parallel_for.h"

namespace s2gs {
namespace {

using Verdict = PictureComparison::Verdict;

constexpr double kMinPersistence = 0.5;  // of a station's photos in which a tile of the background is found
constexpr double kMaxMovedShare =
    0.25;  // of that background that may lie elsewhere in a photo of the station
// Fewer lie elsewhere by chance in a crowd of tiles: a debt, chosen and not derived.
constexpr int kMinMovedTiles = 4;
// Of tiles that lie elsewhere, beyond as many as in the other photos, in standard deviations: one in 160.
constexpr double kMovedSigmas = 2.5;

}  // namespace

WhatStays::WhatStays(const std::vector<PictureComparison>& comparisons, const std::vector<int>& members)
    : needed_(kMinPersistence * static_cast<double>(members.size())),
      num_found_(comparisons[members.front()].tiles.size(), 0),
      num_elsewhere_(num_found_.size(), 0) {
  for (const int m : members) {
    for (size_t t = 0; t < num_found_.size(); ++t) {
      const TileMatch& tile = comparisons[m].tiles[t];
      num_found_[t] += tile.is_found ? 1 : 0;
      num_elsewhere_[t] += tile.is_found && !tile.agrees ? 1 : 0;
    }
  }
}

std::vector<char> WhatStays::PassingTiles() const {
  std::vector<char> is_passing;
  is_passing.reserve(num_found_.size());
  for (size_t t = 0; t < num_found_.size(); ++t)
    is_passing.push_back(num_found_[t] - num_elsewhere_[t] < needed_ ? 1 : 0);
  return is_passing;
}

bool WhatStays::HasMovedIn(const PictureComparison& comparison) const {
  int num_moved = 0;
  int num = 0;
  double expected = 0;
  double variance = 0;
  for (size_t t = 0; t < num_found_.size(); ++t) {
    const TileMatch& tile = comparison.tiles[t];
    if (!tile.is_found || num_found_[t] < needed_) continue;
    const double share = num_elsewhere_[t] / static_cast<double>(num_found_[t]);
    expected += share;
    variance += share * (1 - share);
    ++num;
    num_moved += tile.agrees ? 0 : 1;
  }
  return num_moved >= kMinMovedTiles && num_moved > kMaxMovedShare * num &&
         num_moved - expected > kMovedSigmas * std::sqrt(variance);
}

void LeaveOutMoved(const std::vector<PictureComparison>& comparisons, std::vector<int>* members) {
  if (members->size() < kMinPersistencePhotos) return;
  const WhatStays stays(comparisons, *members);
  members->erase(std::remove_if(members->begin(), members->end(),
                                [&](int m) { return stays.HasMovedIn(comparisons[m]); }),
                 members->end());
}

void CompareByWhatStays(const PictureStandard& standard, const std::vector<GreyPicture>& pictures,
                        const std::vector<int>& images, std::vector<PictureComparison>* comparisons) {
  const auto is_still = [](const PictureComparison& comparison) {
    return comparison.verdict == Verdict::kStill;
  };
  const auto num_still = std::count_if(comparisons->begin(), comparisons->end(), is_still);
  if (num_still < static_cast<std::ptrdiff_t>(kMinPersistencePhotos)) return;
  std::vector<int> num_found(std::find_if(comparisons->begin(), comparisons->end(), is_still)->tiles.size(),
                             0);
  for (const PictureComparison& comparison : *comparisons) {
    for (size_t t = 0; is_still(comparison) && t < num_found.size(); ++t)
      num_found[t] += comparison.tiles[t].is_found ? 1 : 0;
  }
  std::vector<char> is_passing;
  is_passing.reserve(num_found.size());
  for (const int num : num_found)
    is_passing.push_back(num < kMinPersistence * static_cast<double>(num_still) ? 1 : 0);
  ParallelFor(static_cast<int64_t>(images.size()), 0, [&](int64_t i) {
    PictureComparison& comparison = (*comparisons)[i];
    if (is_still(comparison) && comparison.second_from_first.isIdentity()) return;
    PictureComparison without = standard.CompareWith(pictures[images[i]], is_passing);
    if (is_still(without)) comparison = std::move(without);
  });
}

void CompareWithoutPassing(const PictureStandard& standard, const std::vector<GreyPicture>& pictures,
                           const std::vector<int>& images, const std::vector<int>& members,
                           std::vector<PictureComparison>* comparisons) {
  if (members.size() < kMinPersistencePhotos) return;
  const std::vector<char> is_passing = WhatStays(*comparisons, members).PassingTiles();
  ParallelFor(static_cast<int64_t>(members.size()), 0, [&](int64_t k) {
    PictureComparison& comparison = (*comparisons)[members[k]];
    bool is_of_passing = false;
    for (size_t t = 0; t < is_passing.size(); ++t)
      is_of_passing |= is_passing[t] != 0 && comparison.tiles[t].agrees;
    if (!is_of_passing || comparison.second_from_first.isIdentity()) return;
    const PictureComparison without = standard.CompareWith(pictures[images[members[k]]], is_passing);
    if (without.verdict != Verdict::kStill) return;
    comparison.second_from_first = without.second_from_first;
    comparison.log_chance = without.log_chance;
    // What lies elsewhere still says whether the tripod stood elsewhere.
    for (TileMatch& tile : comparison.tiles)
      tile.agrees = IsSeen(tile) && Residual(comparison.second_from_first, tile).norm() <= Bound(tile);
  });
}

}  // namespace s2gs
