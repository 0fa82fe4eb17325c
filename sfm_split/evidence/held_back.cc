#include "sfm_split/evidence/held_back.h"

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <iterator>
#include <numeric>
#include <utility>

#include "sfm_split/base/parallel_for.h"
#include "sfm_split/base/union_find.h"
#include "sfm_split/scene/keypoint_numbers.h"

namespace s2gs {
namespace {

constexpr uint64_t kOneIn = 10;        // sets is held back
constexpr int64_t kTiesInARow = 1024;  // by one thread: one is done in less time than it takes to hand it out

uint64_t Mix(uint64_t x) {  // SplitMix64's
  x += 0x9e3779b97f4a7c15ULL;
  x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9ULL;
  x = (x ^ (x >> 27)) * 0x94d049bb133111ebULL;
  return x ^ (x >> 31);
}

// A match, by the numbers of both keypoints among all images'.
struct Tie {
  int image1 = 0;
  int image2 = 0;
  uint32_t keypoint1 = 0;
  uint32_t keypoint2 = 0;
  int witnesses = 0;  // keypoints that both ends are matched with
};

// What each keypoint is matched with, in order of their numbers.
class Neighbours {
 public:
  Neighbours(const std::vector<Tie>& ties, size_t num_keypoints) : end_(num_keypoints + 1, 0) {
    for (const Tie& tie : ties) {
      ++end_[tie.keypoint1 + 1];
      ++end_[tie.keypoint2 + 1];
    }
    std::partial_sum(end_.begin(), end_.end(), end_.begin());
    others_.resize(end_.back());
    std::vector<size_t> next(end_.begin(), end_.end() - 1);
    for (const Tie& tie : ties) {
      others_[next[tie.keypoint1]++] = tie.keypoint2;
      others_[next[tie.keypoint2]++] = tie.keypoint1;
    }
    for (size_t k = 0; k < num_keypoints; ++k) std::sort(Begin(k), Begin(k + 1));
  }

  int Common(uint32_t a, uint32_t b) const {
    int common = 0;
    auto i = others_.begin() + static_cast<std::ptrdiff_t>(end_[a]);
    auto j = others_.begin() + static_cast<std::ptrdiff_t>(end_[b]);
    const auto i_end = others_.begin() + static_cast<std::ptrdiff_t>(end_[a + 1]);
    const auto j_end = others_.begin() + static_cast<std::ptrdiff_t>(end_[b + 1]);
    while (i != i_end && j != j_end) {
      if (*i < *j) {
        ++i;
      } else if (*j < *i) {
        ++j;
      } else {
        ++common;
        ++i;
        ++j;
      }
    }
    return common;
  }

 private:
  std::vector<uint32_t>::iterator Begin(size_t keypoint) {
    return others_.begin() + static_cast<std::ptrdiff_t>(end_[keypoint]);
  }

  std::vector<size_t> end_;  // of the one before
  std::vector<uint32_t> others_;
};

// Matches, those first of whose ends most keypoints are matched with both: a wrong match has few such
// witnesses, since each takes two more that are wrong alike.
std::vector<Tie> MostWitnessedFirst(const ScanFeatures& features, const KeypointNumbers& numbers) {
  std::vector<Tie> ties;
  for (const ImagePairMatches& pair : features.object_pairs) {
    for (const FeatureMatch& match : pair.matches) {
      ties.push_back({pair.image1, pair.image2, numbers.Of(pair.image1, match.point2D_idx1),
                      numbers.Of(pair.image2, match.point2D_idx2), 0});
    }
  }
  const Neighbours neighbours(ties, numbers.Count());
  ParallelFor(static_cast<int64_t>(ties.size()), 0, kTiesInARow, [&](int64_t t) {
    Tie& tie = ties[static_cast<size_t>(t)];
    tie.witnesses = neighbours.Common(tie.keypoint1, tie.keypoint2);
  });
  std::stable_sort(ties.begin(), ties.end(),
                   [](const Tie& a, const Tie& b) { return a.witnesses > b.witnesses; });
  return ties;
}

// Sets of keypoints with at most one of each image.
class OneOfEachImage {
 public:
  explicit OneOfEachImage(size_t num_keypoints) : sets_(num_keypoints), images_of_(num_keypoints) {}

  // Puts the sets of both ends of a match together, unless both have a keypoint of the same image.
  void Join(const Tie& tie) {
    const uint32_t a = Root(tie.image1, tie.keypoint1);
    const uint32_t b = Root(tie.image2, tie.keypoint2);
    if (a == b) return;
    std::vector<int> both;
    std::set_union(images_of_[a].begin(), images_of_[a].end(), images_of_[b].begin(), images_of_[b].end(),
                   std::back_inserter(both));
    if (both.size() < images_of_[a].size() + images_of_[b].size()) return;
    sets_.Join(a, b);
    images_of_[std::max(a, b)] = {};
    images_of_[std::min(a, b)] = std::move(both);
  }

  // kNoSet: tied to no other.
  uint32_t SetOf(uint32_t keypoint) {
    const uint32_t root = sets_.Root(keypoint);
    return images_of_[root].size() < 2 ? kNoSet : root;
  }

 private:
  uint32_t Root(int image, uint32_t keypoint) {
    const uint32_t root = sets_.Root(keypoint);
    if (images_of_[root].empty()) images_of_[root] = {image};  // not matched so far: its own root
    return root;
  }

  UnionFind sets_;
  std::vector<std::vector<int>> images_of_;  // by root; sorted
};

}  // namespace

KeypointSets SetsOfKeypoints(const ScanFeatures& features) {
  KeypointNumbers numbers;
  for (const ScanImage& image : features.images) numbers.Add(image.keypoints.size());
  OneOfEachImage sets(numbers.Count());
  for (const Tie& tie : MostWitnessedFirst(features, numbers)) sets.Join(tie);
  KeypointSets of_images(features.images.size());
  for (size_t i = 0; i < of_images.size(); ++i) {
    const size_t count = features.images[i].keypoints.size();
    of_images[i].reserve(count);
    for (uint32_t k = 0; k < count; ++k)
      of_images[i].push_back(sets.SetOf(numbers.Of(static_cast<int>(i), k)));
  }
  return of_images;
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
