#include "sfm_split/matching/pair_plan.h"

#include <algorithm>
#include <map>
#include <numeric>
#include <string>
#include <utility>

#include "sfm_split/base/error.h"
#include "sfm_split/base/union_find.h"

namespace s2gs {
namespace {

void Append(uint32_t a, uint32_t b, std::vector<ImagePair>* pairs) {
  if (a != b) pairs->push_back({std::min(a, b), std::max(a, b)});
}

void SortUnique(std::vector<ImagePair>* pairs) {
  std::sort(pairs->begin(), pairs->end());
  pairs->erase(std::unique(pairs->begin(), pairs->end()), pairs->end());
}

void CheckOrder(const std::vector<uint32_t>& order) {
  std::vector<bool> seen(order.size());
  for (const uint32_t image : order) {
    S2GS_INVARIANT(image < order.size() && !seen[image]);
    seen[image] = true;
  }
}

bool IsDigit(char c) { return c >= '0' && c <= '9'; }

// -1, 0, 1. Runs of digits as numbers of any length.
int CompareNaturally(const std::string& a, const std::string& b) {
  size_t i = 0;
  size_t j = 0;
  while (i < a.size() && j < b.size()) {
    if (IsDigit(a[i]) && IsDigit(b[j])) {
      while (i < a.size() && a[i] == '0') ++i;
      while (j < b.size() && b[j] == '0') ++j;
      const size_t begin_a = i;
      const size_t begin_b = j;
      while (i < a.size() && IsDigit(a[i])) ++i;
      while (j < b.size() && IsDigit(b[j])) ++j;
      const size_t digits_a = i - begin_a;
      const size_t digits_b = j - begin_b;
      if (digits_a != digits_b) return digits_a < digits_b ? -1 : 1;
      const int order = a.compare(begin_a, digits_a, b, begin_b, digits_b);
      if (order != 0) return order < 0 ? -1 : 1;
    } else {
      if (a[i] != b[j]) return static_cast<unsigned char>(a[i]) < static_cast<unsigned char>(b[j]) ? -1 : 1;
      ++i;
      ++j;
    }
  }
  if (i < a.size() || j < b.size()) return i < a.size() ? 1 : -1;
  return 0;
}

// Images of each station, in the order of `order`.
std::map<int, std::vector<uint32_t>> ImagesOfStations(const std::vector<int>& station,
                                                      const std::vector<uint32_t>& order) {
  std::map<int, std::vector<uint32_t>> images;
  for (const uint32_t image : order) {
    if (station[image] >= 0) images[station[image]].push_back(image);
  }
  return images;
}

std::vector<uint32_t> Range(size_t num) {
  std::vector<uint32_t> range(num);
  std::iota(range.begin(), range.end(), 0U);
  return range;
}

}  // namespace

std::vector<ImagePair> NewPairs(std::vector<ImagePair> pairs, const std::vector<ImagePair>& done) {
  SortUnique(&pairs);
  std::vector<ImagePair> sorted_done = done;
  SortUnique(&sorted_done);
  std::vector<ImagePair> fresh;
  std::set_difference(pairs.begin(), pairs.end(), sorted_done.begin(), sorted_done.end(),
                      std::back_inserter(fresh));
  return fresh;
}

std::vector<uint32_t> NaturalNameOrder(const std::vector<std::string>& names) {
  std::vector<uint32_t> order = Range(names.size());
  std::sort(order.begin(), order.end(), [&](uint32_t i, uint32_t j) {
    const int natural = CompareNaturally(names[i], names[j]);
    if (natural != 0) return natural < 0;
    return names[i] != names[j] ? names[i] < names[j] : i < j;  // "a01" and "a1"
  });
  return order;
}

double OrderAgreement(const std::vector<uint32_t>& order, const SimilarityMatrix& similarity) {
  CheckOrder(order);
  const size_t num = order.size();
  S2GS_INVARIANT(similarity.rows() == static_cast<Eigen::Index>(num) &&
                 similarity.cols() == similarity.rows());
  if (num < 3) return 1.0;
  double sum = 0.0;
  for (size_t place = 0; place < num; ++place) {
    const uint32_t image = order[place];
    uint32_t best = 0;
    if (place > 0) best = std::max(best, similarity(image, order[place - 1]));
    if (place + 1 < num) best = std::max(best, similarity(image, order[place + 1]));
    double less = -0.5;  // the neighbour itself is among the ties
    for (size_t other = 0; other < num; ++other) {
      if (other == image) continue;
      const uint32_t value = similarity(image, other);
      less += value < best ? 1.0 : value == best ? 0.5 : 0.0;
    }
    sum += less / static_cast<double>(num - 2);
  }
  return sum / static_cast<double>(num);
}

std::vector<ImagePair> NeighbourPairs(const std::vector<uint32_t>& order, int window, bool wrap) {
  CheckOrder(order);
  S2GS_INVARIANT(window >= 1);
  std::vector<ImagePair> pairs;
  const size_t num = order.size();
  for (size_t place = 0; place < num; ++place) {
    for (size_t step = 1; step <= static_cast<size_t>(window) && step < num; ++step) {
      if (place + step < num || wrap) Append(order[place], order[(place + step) % num], &pairs);
    }
  }
  SortUnique(&pairs);
  return pairs;
}

std::vector<ImagePair> SimilarPairs(const SimilarityMatrix& similarity, int num_partners) {
  S2GS_INVARIANT(similarity.rows() == similarity.cols() && num_partners >= 1);
  const auto num = static_cast<uint32_t>(similarity.rows());
  std::vector<ImagePair> pairs;
  std::vector<uint32_t> others;
  for (uint32_t image = 0; image < num; ++image) {
    others.clear();
    for (uint32_t other = 0; other < num; ++other) {
      if (other != image && similarity(image, other) > 0) others.push_back(other);
    }
    const size_t num_kept = std::min(others.size(), static_cast<size_t>(num_partners));
    std::partial_sort(others.begin(), others.begin() + num_kept, others.end(), [&](uint32_t i, uint32_t j) {
      return similarity(image, i) != similarity(image, j) ? similarity(image, i) > similarity(image, j)
                                                          : i < j;
    });
    for (size_t k = 0; k < num_kept; ++k) Append(image, others[k], &pairs);
  }
  SortUnique(&pairs);

  UnionFind components(num);
  for (const ImagePair pair : pairs) components.Join(pair.first, pair.second);
  std::vector<ImagePair> rest;
  for (uint32_t i = 0; i < num; ++i) {
    for (uint32_t j = i + 1; j < num; ++j) {
      if (similarity(i, j) > 0) rest.push_back({i, j});
    }
  }
  std::stable_sort(rest.begin(), rest.end(), [&](ImagePair a, ImagePair b) {
    return similarity(a.first, a.second) > similarity(b.first, b.second);
  });
  for (const ImagePair pair : rest) {
    if (components.Join(pair.first, pair.second)) pairs.push_back(pair);
  }
  SortUnique(&pairs);
  return pairs;
}

std::vector<uint32_t> StationRepresentatives(const std::vector<int>& station,
                                             const std::vector<uint32_t>& num_features) {
  S2GS_INVARIANT(station.size() == num_features.size());
  std::vector<uint32_t> representatives;
  for (const auto& [id, images] : ImagesOfStations(station, Range(station.size()))) {
    representatives.push_back(*std::max_element(images.begin(), images.end(), [&](uint32_t i, uint32_t j) {
      return num_features[i] < num_features[j];
    }));
  }
  return representatives;
}

std::vector<ImagePair> RepresentativePairs(const std::vector<uint32_t>& representatives, int max_partners) {
  S2GS_INVARIANT(max_partners >= 1);
  std::vector<ImagePair> pairs;
  const size_t num = representatives.size();
  const bool all = num <= static_cast<size_t>(max_partners) + 1;
  for (size_t i = 0; i < num; ++i) {
    if (all) {
      for (size_t j = i + 1; j < num; ++j) Append(representatives[i], representatives[j], &pairs);
      continue;
    }
    size_t step = 1;
    for (int k = 0; k < max_partners && i + step < num; ++k, step *= 2) {
      Append(representatives[i], representatives[i + step], &pairs);
    }
  }
  SortUnique(&pairs);
  return pairs;
}

}  // namespace s2gs
