#include "sfm_split/split/picture_order.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <limits>
#include <numeric>
#include <random>
#include <utility>

#include "sfm_split/base/error.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

constexpr int kBlockPx = 2;        // pixels are averaged over squares of this side
constexpr size_t kMinBlocks = 30;  // that change
constexpr size_t kMinPhotos = 8;   // fewer have too few orders to tell one from chance
constexpr size_t kMaxStarts = 12;  // photos from which a way is begun
constexpr int kMaxPasses = 200;    // of improving one
// An order that is shorter than each of so many others is so by chance once in as many scans.
constexpr int kChanceOrders = 1000;

using Distances = Eigen::MatrixXf;
using Way = std::vector<uint32_t>;

// What a photo shows where things change, in the first photo's exposure: one mean a block.
std::vector<Eigen::VectorXf> ActiveBlocks(const std::vector<const GreyPicture*>& photos,
                                          const std::vector<uint8_t>& is_active) {
  const GreyPicture& first = *photos.front();
  std::vector<size_t> corners;
  std::vector<size_t> still;
  for (int y = 0; y + kBlockPx <= first.height; y += kBlockPx) {
    for (int x = 0; x + kBlockPx <= first.width; x += kBlockPx) {
      const size_t corner = static_cast<size_t>(y) * first.width + x;
      const size_t middle = corner + (kBlockPx / 2) * (static_cast<size_t>(first.width) + 1);
      (is_active[middle] != 0 ? corners : still).push_back(corner);
    }
  }
  if (corners.size() < kMinBlocks) return {};
  const auto mean = [&](const GreyPicture& photo, size_t corner) {
    int sum = 0;
    for (int y = 0; y < kBlockPx; ++y) {
      for (int x = 0; x < kBlockPx; ++x) sum += photo.grey[corner + static_cast<size_t>(y) * first.width + x];
    }
    return static_cast<float>(sum) / (kBlockPx * kBlockPx);
  };
  std::vector<Eigen::VectorXf> blocks;
  blocks.reserve(photos.size());
  for (const GreyPicture* photo : photos) {
    std::vector<float> ratios;
    for (const size_t corner : still) {
      const float here = mean(*photo, corner);
      const float there = mean(first, corner);
      if (here >= 8 && there >= 8) ratios.push_back(there / here);
    }
    const float gain = ratios.size() < kMinBlocks ? 1 : UpperMedian(std::move(ratios));
    Eigen::VectorXf& values = blocks.emplace_back(static_cast<Eigen::Index>(corners.size()));
    for (size_t k = 0; k < corners.size(); ++k)
      values(static_cast<Eigen::Index>(k)) = gain * mean(*photo, corners[k]);
  }
  return blocks;
}

double Length(const Way& way, const Distances& distance) {
  double sum = 0;
  for (size_t k = 0; k < way.size(); ++k) sum += distance(way[k], way[(k + 1) % way.size()]);
  return sum;
}

Way NearestNeighbours(uint32_t start, const Distances& distance) {
  Way left(static_cast<size_t>(distance.rows()));
  std::iota(left.begin(), left.end(), 0U);
  Way way = {start};
  left.erase(left.begin() + start);
  while (!left.empty()) {
    const auto next = std::min_element(left.begin(), left.end(), [&](uint32_t a, uint32_t b) {
      return distance(way.back(), a) < distance(way.back(), b);
    });
    way.push_back(*next);
    left.erase(next);
  }
  return way;
}

// Turns parts around while that shortens the way (2-opt; Croes 1958). True when any did.
bool TurnParts(const Distances& distance, Way* way) {
  const size_t num = way->size();
  bool has_improved = false;
  for (size_t i = 0; i + 2 < num; ++i) {
    for (size_t j = i + 2; j < num; ++j) {
      if (i == 0 && j + 1 == num) continue;
      const uint32_t a = (*way)[i];
      const uint32_t b = (*way)[i + 1];
      const uint32_t c = (*way)[j];
      const uint32_t d = (*way)[(j + 1) % num];
      if (distance(a, c) + distance(b, d) >= distance(a, b) + distance(c, d) - 1e-4F) continue;
      std::reverse(way->begin() + static_cast<std::ptrdiff_t>(i + 1),
                   way->begin() + static_cast<std::ptrdiff_t>(j + 1));
      has_improved = true;
    }
  }
  return has_improved;
}

// Moves single photos to where they lengthen the way least. True when any moved.
bool MovePhotos(const Distances& distance, Way* way) {
  bool has_improved = false;
  const size_t num = way->size();
  for (size_t i = 0; i < num; ++i) {
    const uint32_t photo = (*way)[i];
    Way rest = *way;
    rest.erase(rest.begin() + static_cast<std::ptrdiff_t>(i));
    const auto detour = [&](size_t k) {
      const uint32_t a = rest[k];
      const uint32_t b = rest[(k + 1) % rest.size()];
      return distance(a, photo) + distance(photo, b) - distance(a, b);
    };
    const float now = detour((i + rest.size() - 1) % rest.size());
    size_t best = 0;
    for (size_t k = 1; k < rest.size(); ++k) best = detour(k) < detour(best) ? k : best;
    if (detour(best) >= now - 1e-4F) continue;
    rest.insert(rest.begin() + static_cast<std::ptrdiff_t>(best + 1), photo);
    *way = std::move(rest);
    has_improved = true;
  }
  return has_improved;
}

Distances DistancesOf(const std::vector<Eigen::VectorXf>& blocks) {
  const auto num = static_cast<Eigen::Index>(blocks.size());
  Distances distance = Distances::Zero(num, num);
  for (Eigen::Index i = 0; i < num; ++i) {
    for (Eigen::Index j = i + 1; j < num; ++j) {
      distance(i, j) = (blocks[static_cast<size_t>(i)] - blocks[static_cast<size_t>(j)]).norm();
      distance(j, i) = distance(i, j);
    }
  }
  return distance;
}

// Of many orders that know nothing of the pictures.
double ShortestByChance(const Distances& distance) {
  Way way(static_cast<size_t>(distance.rows()));
  std::iota(way.begin(), way.end(), 0U);
  std::mt19937 rng(0);
  double shortest = std::numeric_limits<double>::infinity();
  for (int k = 0; k < kChanceOrders; ++k) {
    for (size_t i = way.size() - 1; i > 0; --i) std::swap(way[i], way[rng() % (i + 1)]);
    shortest = std::min(shortest, Length(way, distance));
  }
  return shortest;
}

Way ShortestWay(const Distances& distance) {
  const auto num = static_cast<size_t>(distance.rows());
  Way best;
  double shortest = std::numeric_limits<double>::infinity();
  const size_t num_starts = std::min(kMaxStarts, num);
  for (size_t s = 0; s < num_starts; ++s) {
    Way way = NearestNeighbours(static_cast<uint32_t>(s * num / num_starts), distance);
    for (int pass = 0; pass < kMaxPasses; ++pass) {
      const bool has_turned = TurnParts(distance, &way);
      if (!MovePhotos(distance, &way) && !has_turned) break;
    }
    const double length = Length(way, distance);
    if (length >= shortest) continue;
    shortest = length;
    best = std::move(way);
  }
  return best;
}

// From the photo after the longest step on, away from it; that end of the step whose other step is shorter.
Way FromLongestStep(Way way, const Distances& distance) {
  const size_t num = way.size();
  const auto step = [&](size_t k) { return distance(way[k % num], way[(k + 1) % num]); };
  size_t longest = 0;
  for (size_t k = 1; k < num; ++k) longest = step(k) > step(longest) ? k : longest;
  const bool is_backwards = step(longest + num - 1) < step(longest + 1);
  const size_t begin = is_backwards ? longest : (longest + 1) % num;
  std::rotate(way.begin(), way.begin() + static_cast<std::ptrdiff_t>(begin), way.end());
  if (is_backwards) std::reverse(way.begin() + 1, way.end());
  return way;
}

}  // namespace

std::vector<uint32_t> OrderByContent(const std::vector<GreyPicture>& photos) {
  Way order(photos.size());
  std::iota(order.begin(), order.end(), 0U);
  std::stable_sort(order.begin(), order.end(),
                   [&](uint32_t a, uint32_t b) { return photos[a].grey < photos[b].grey; });
  return order;
}

std::vector<uint32_t> OrderByPictures(const std::vector<const GreyPicture*>& photos,
                                      const std::vector<uint8_t>& is_active,
                                      const std::vector<uint32_t>& by_name) {
  S2GS_INVARIANT(by_name.size() == photos.size());
  if (photos.size() < kMinPhotos) return {};
  for (const GreyPicture* photo : photos) {
    if (photo->width != photos.front()->width || photo->height != photos.front()->height) return {};
  }
  if (is_active.size() != photos.front()->grey.size()) return {};
  const std::vector<Eigen::VectorXf> blocks = ActiveBlocks(photos, is_active);
  if (blocks.empty()) return {};
  const Distances distance = DistancesOf(blocks);
  if (Length(by_name, distance) < ShortestByChance(distance)) return by_name;
  return FromLongestStep(ShortestWay(distance), distance);
}

std::vector<uint32_t> OrderOfCapture(const std::vector<GreyPicture>& photos, const PictureStations& stations,
                                     const SceneChanges& changes,
                                     const std::vector<uint32_t>& place_by_name) {
  S2GS_INVARIANT(place_by_name.size() == photos.size());
  std::vector<Way> of_station(changes.stations.size());
  for (uint32_t i = 0; i < photos.size(); ++i)
    of_station[static_cast<size_t>(stations.station_of_image[i])].push_back(i);
  bool is_by_name = true;
  Way order;
  order.reserve(photos.size());
  for (size_t s = 0; s < of_station.size(); ++s) {
    const Way& given = of_station[s];
    std::vector<const GreyPicture*> pictures;
    pictures.reserve(given.size());
    for (const uint32_t i : given) pictures.push_back(&photos[i]);
    Way by_name(given.size());
    std::iota(by_name.begin(), by_name.end(), 0U);
    std::sort(by_name.begin(), by_name.end(),
              [&](uint32_t a, uint32_t b) { return place_by_name[given[a]] < place_by_name[given[b]]; });
    const Way by_pictures = OrderByPictures(pictures, changes.stations[s].is_active, by_name);
    const Way& taken = by_pictures.empty() ? by_name : by_pictures;
    is_by_name = is_by_name && taken == by_name;
    for (const uint32_t k : taken) order.push_back(given[k]);
  }
  return is_by_name ? Way() : order;
}

}  // namespace s2gs
