#include "sfm_split/evidence/held_back.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <iterator>
#include <utility>

#include "sfm_split/base/union_find.h"

namespace s2gs {
namespace {

constexpr uint64_t kOneIn = 10;  // sets is held back

uint64_t Mix(uint64_t x) {  // SplitMix64's
  x += 0x9e3779b97f4a7c15ULL;
  x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9ULL;
  x = (x ^ (x >> 27)) * 0x94d049bb133111ebULL;
  return x ^ (x >> 31);
}

// Sets of keypoints with at most one of each image.
class OneOfEachImage {
 public:
  explicit OneOfEachImage(const std::vector<ScanImage>& images) : first_(images.size() + 1, 0), sets_(0) {
    for (size_t i = 0; i < images.size(); ++i) first_[i + 1] = first_[i] + images[i].keypoints.size();
    sets_ = UnionFind(first_.back());
    images_of_.resize(first_.back());
  }

  // Puts the sets of both ends of a match together, unless both have a keypoint of the same image.
  void Join(const ImagePairMatches& pair, const FeatureMatch& match) {
    const uint32_t a = Root(pair.image1, match.point2D_idx1);
    const uint32_t b = Root(pair.image2, match.point2D_idx2);
    if (a == b) return;
    std::vector<int> both;
    std::set_union(images_of_[a].begin(), images_of_[a].end(), images_of_[b].begin(), images_of_[b].end(),
                   std::back_inserter(both));
    if (both.size() < images_of_[a].size() + images_of_[b].size()) return;
    sets_.Join(a, b);
    images_of_[std::max(a, b)] = {};
    images_of_[std::min(a, b)] = std::move(both);
  }

  KeypointSets Sets() {
    KeypointSets sets(first_.size() - 1);
    for (size_t i = 0; i < sets.size(); ++i) {
      sets[i].assign(first_[i + 1] - first_[i], kNoSet);
      for (size_t k = 0; k < sets[i].size(); ++k) {
        const uint32_t root = sets_.Root(static_cast<uint32_t>(first_[i] + k));
        if (!images_of_[root].empty()) sets[i][k] = root;
      }
    }
    return sets;
  }

 private:
  uint32_t Root(int image, uint32_t keypoint) {
    const uint32_t root = sets_.Root(static_cast<uint32_t>(first_[static_cast<size_t>(image)] + keypoint));
    if (images_of_[root].empty()) images_of_[root] = {image};  // not matched so far: its own root
    return root;
  }

  std::vector<size_t> first_;  // keypoint of each image
  UnionFind sets_;
  std::vector<std::vector<int>> images_of_;  // by root; sorted
};

}  // namespace

KeypointSets SetsOfKeypoints(const ScanFeatures& features) {
  OneOfEachImage sets(features.images);
  for (const ImagePairMatches& pair : features.object_pairs) {
    for (const FeatureMatch& match : pair.matches) sets.Join(pair, match);
  }
  return sets.Sets();
}

HeldBackKeypoints HoldBack(const ScanFeatures& features) {
  HeldBackKeypoints held;
  for (const std::vector<uint32_t>& of_image : SetsOfKeypoints(features)) {
    std::vector<bool>& chosen = held.emplace_back();
    chosen.reserve(of_image.size());
    for (const uint32_t set : of_image) chosen.push_back(set != kNoSet && Mix(set) % kOneIn == 0);
  }
  return held;
}

}  // namespace s2gs
