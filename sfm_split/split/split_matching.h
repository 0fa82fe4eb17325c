#pragma once

#include <algorithm>
#include <cstdint>
#include <set>
#include <utility>
#include <vector>

#include "sfm_split/matching/pair_plan.h"
#include "sfm_split/split/motion_split.h"

namespace s2gs {

/// The descriptors of some of the images' keypoints, ready to be matched.
using PackedImages = std::vector<PackedDescriptors>;

/// Two images, the one with the smaller number first.
inline ImagePair OrderedPair(int a, int b) {
  return {static_cast<uint32_t>(std::min(a, b)), static_cast<uint32_t>(std::max(a, b))};
}

/// What every kind of split does with images: match pairs, count matches cheaply, fit motions.
class SplitMatching {
 public:
  SplitMatching(const std::vector<SplitImage>& images, const SplitSettings& settings, Reporter* reporter,
                const GivenMatches& given);

  /// Descriptors of all keypoints.
  PackedImages PackAll() const;
  /// Descriptors of each image's `num` largest keypoints of those that `is_wanted(image, keypoint)` names.
  template <typename IsWanted>
  PackedImages PackLargest(size_t num, const IsWanted& is_wanted) const {
    PackedImages packed;
    packed.reserve(images_.size());
    std::vector<uint32_t> rows;
    for (size_t i = 0; i < images_.size(); ++i) {
      rows.clear();
      for (uint32_t k = 0; k < images_[i].keypoints.size(); ++k) {
        if (is_wanted(static_cast<int>(i), k)) rows.push_back(k);
      }
      KeepLargest(images_[i], num, &rows);
      packed.emplace_back(images_[i].descriptors.data(), images_[i].keypoints.size(), rows);
    }
    return packed;
  }

  /// Matches pairs, in blocks so that progress shows and a stop is heard, or takes what was given for them of
  /// the keypoints in `packed`. Throws Interrupted.
  std::vector<ImagePairMatches> Match(const std::vector<ImagePair>& pairs, const PackedImages& packed,
                                      const char* task);

  /// The motion that most of `subset` of the pair's matches follow; no matches when there is none.
  VerifiedPair Verify(const ImagePairMatches& pair, const std::vector<int>& subset) const;
  /// Verify() of all pairs with all threads; a subset per pair, or none for all matches. Pairs without a
  /// motion come back without matches.
  std::vector<VerifiedPair> VerifyAll(const std::vector<ImagePairMatches>& pairs,
                                      const std::vector<std::vector<int>>* subsets, const char* task);

  /// Widens the bounds in pixels where keypoints turn out to lie less exactly than the options expect.
  /// \param unmoved_px  median distance from their place of keypoints that did not move [px].
  void AdaptToNoise(double unmoved_px);

  const std::vector<SplitImage>& images() const { return images_; }
  const std::vector<Keypoints>& keypoints() const { return keypoints_; }
  const std::vector<Eigen::Vector2i>& sizes() const { return sizes_; }
  /// With bounds in pixels of the photos' size: the options' are for photos of up to 1600 pixels.
  const SplitSettings& settings() const { return settings_; }
  Reporter& reporter() const { return reporter_; }
  DescriptorMatcher* matcher() { return &matcher_; }
  const GivenMatches& given() const { return given_; }
  int NumImages() const { return static_cast<int>(images_.size()); }
  /// Pairs that Match() was given, each counted once.
  int64_t num_pairs_matched() const { return static_cast<int64_t>(matched_.size()); }

 private:
  std::vector<ImagePairMatches> TakeGiven(const std::vector<ImagePair>& pairs,
                                          const PackedImages& packed) const;
  static void KeepLargest(const SplitImage& image, size_t num, std::vector<uint32_t>* rows);

  const std::vector<SplitImage>& images_;
  const GivenMatches& given_;
  SplitSettings settings_;
  Reporter& reporter_;
  DescriptorMatcher matcher_;
  std::vector<Keypoints> keypoints_;
  std::vector<Eigen::Vector2i> sizes_;
  std::set<ImagePair> matched_;
};

}  // namespace s2gs
