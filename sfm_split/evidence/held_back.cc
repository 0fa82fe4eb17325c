#include "sfm_split/evidence/held_back.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <set>

namespace s2gs {
namespace {

constexpr uint64_t kOneIn = 10;  // tracks is held back

uint64_t Mix(uint64_t x) {  // SplitMix64's
  x += 0x9e3779b97f4a7c15ULL;
  x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9ULL;
  x = (x ^ (x >> 27)) * 0x94d049bb133111ebULL;
  return x ^ (x >> 31);
}

}  // namespace

HeldBackKeypoints HoldBack(const ScanFeatures& features) {
  const size_t num = features.images.size();
  std::vector<size_t> first(num + 1, 0);
  for (size_t i = 0; i < num; ++i) first[i + 1] = first[i] + features.images[i].keypoints.size();
  std::vector<std::vector<size_t>> matched(first.back());
  for (const ImagePairMatches& pair : features.object_pairs) {
    for (const FeatureMatch& match : pair.matches) {
      const size_t a = first[static_cast<size_t>(pair.image1)] + match.point2D_idx1;
      const size_t b = first[static_cast<size_t>(pair.image2)] + match.point2D_idx2;
      matched[a].push_back(b);
      matched[b].push_back(a);
    }
  }
  const auto image_of = [&](size_t k) {
    return std::upper_bound(first.begin(), first.end(), k) - first.begin() - 1;
  };
  std::vector<bool> seen(first.back(), false);
  std::vector<bool> held(first.back(), false);
  for (size_t start = 0; start < matched.size(); ++start) {
    if (seen[start] || matched[start].empty()) continue;
    std::vector<size_t> set = {start};
    seen[start] = true;
    for (size_t at = 0; at < set.size(); ++at) {
      for (const size_t next : matched[set[at]]) {
        if (!seen[next]) set.push_back(next);
        seen[next] = true;
      }
    }
    if (Mix(start) % kOneIn != 0) continue;
    std::set<std::ptrdiff_t> images;
    for (const size_t k : set) images.insert(image_of(k));
    if (images.size() != set.size()) continue;
    for (const size_t k : set) held[k] = true;
  }
  HeldBackKeypoints result(num);
  for (size_t i = 0; i < num; ++i) {
    result[i].assign(held.begin() + static_cast<std::ptrdiff_t>(first[i]),
                     held.begin() + static_cast<std::ptrdiff_t>(first[i + 1]));
  }
  return result;
}

}  // namespace s2gs
