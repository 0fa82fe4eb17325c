#include "sfm_split/split/split_matching.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "sfm_split/base/parallel_for.h"
#include "sfm_split/split/pair_evidence.h"

namespace s2gs {
namespace {

constexpr double kReferenceSidePx = 1600;  // photos up to this size have the options' bounds

}  // namespace

SplitMatching::SplitMatching(const std::vector<SplitImage>& images, const SplitSettings& settings,
                             Reporter* reporter, const GivenMatches& given)
    : images_(images), given_(given), settings_(settings), reporter_(*reporter), matcher_(settings.match) {
  int longest_side = 0;
  keypoints_.reserve(images.size());
  sizes_.reserve(images.size());
  for (const SplitImage& image : images) {
    keypoints_.push_back(image.keypoints);
    sizes_.push_back(image.size);
    longest_side = std::max(longest_side, image.size.maxCoeff());
  }
  const double scale = std::max(1.0, longest_side / kReferenceSidePx);
  settings_.station = settings_.station.ForPhotosOf(longest_side);
  settings_.motion.max_error_px *= scale;
  settings_.split.min_moved_px *= scale;
}

void SplitMatching::AdaptToNoise(double unmoved_px) {
  // The distance of two places with a standard deviation of sigma in x and in y is Rayleigh's: its median is
  // 1.18 sqrt(2) sigma.
  const double sigma = unmoved_px / 1.665;
  settings_.station.max_unmoved_px = std::max(settings_.station.max_unmoved_px, 3.0 * std::sqrt(2.0) * sigma);
  settings_.motion.max_error_px = std::max(settings_.motion.max_error_px, 3.0 * sigma);
  settings_.split.min_moved_px =
      std::max(settings_.split.min_moved_px, 1.3 * settings_.station.max_unmoved_px);
}

PackedImages SplitMatching::PackAll() const {
  PackedImages packed(images_.size());
  ParallelFor(static_cast<int64_t>(images_.size()), 0, [&](int64_t i) {
    const SplitImage& image = images_[static_cast<size_t>(i)];
    packed[static_cast<size_t>(i)] = PackedDescriptors(image.descriptors.data(), image.keypoints.size());
  });
  return packed;
}

void SplitMatching::KeepLargest(const SplitImage& image, size_t num, std::vector<uint32_t>* rows) {
  if (rows->size() <= num) return;
  if (!image.scales.empty()) {
    std::nth_element(rows->begin(), rows->begin() + static_cast<std::ptrdiff_t>(num), rows->end(),
                     [&](uint32_t i, uint32_t j) {
                       return image.scales[i] != image.scales[j] ? image.scales[i] > image.scales[j] : i < j;
                     });
  }
  rows->resize(num);
  std::sort(rows->begin(), rows->end());
}

std::vector<ImagePairMatches> SplitMatching::TakeGiven(const std::vector<ImagePair>& pairs,
                                                       const PackedImages& packed) const {
  std::vector<std::vector<bool>> is_packed(packed.size());
  for (size_t i = 0; i < packed.size(); ++i) {
    is_packed[i].assign(images_[i].keypoints.size(), false);
    for (const uint32_t row : packed[i].slot_index()) {
      if (row != PackedDescriptors::kPadding) is_packed[i][row] = true;
    }
  }
  std::vector<ImagePairMatches> result;
  result.reserve(pairs.size());
  for (const auto& [i, j] : pairs) {
    ImagePairMatches pair{static_cast<int>(i), static_cast<int>(j), {}};
    const auto given = given_.find({std::min(i, j), std::max(i, j)});
    if (given != given_.end()) {
      pair.matches.reserve(given->second.size());
      for (FeatureMatch match : given->second) {
        if (i > j) std::swap(match.point2D_idx1, match.point2D_idx2);
        if (is_packed[i][match.point2D_idx1] && is_packed[j][match.point2D_idx2])
          pair.matches.push_back(match);
      }
    }
    result.push_back(std::move(pair));
  }
  return result;
}

std::vector<ImagePairMatches> SplitMatching::Match(const std::vector<ImagePair>& pairs,
                                                   const PackedImages& packed, const char* task) {
  constexpr size_t kBlock = 32;  // pairs between two looks at whether to stop
  for (const auto& [i, j] : pairs) matched_.insert({std::min(i, j), std::max(i, j)});
  if (!given_.empty()) return TakeGiven(pairs, packed);
  std::vector<ImagePairMatches> result;
  result.reserve(pairs.size());
  std::vector<DescriptorMatcher::Job> jobs;
  std::vector<FeatureMatches> matches;
  for (size_t begin = 0; begin < pairs.size(); begin += kBlock) {
    if (reporter_.StopRequested()) throw Interrupted();
    reporter_.Progress(task, static_cast<int64_t>(begin), static_cast<int64_t>(pairs.size()));
    const size_t end = std::min(begin + kBlock, pairs.size());
    jobs.clear();
    jobs.reserve(kBlock);
    for (size_t p = begin; p < end; ++p) jobs.push_back({&packed[pairs[p].first], &packed[pairs[p].second]});
    matcher_.MatchAll(jobs, &matches);
    for (size_t p = begin; p < end; ++p) {
      result.push_back({static_cast<int>(pairs[p].first), static_cast<int>(pairs[p].second),
                        std::move(matches[p - begin])});
    }
  }
  if (!pairs.empty()) {
    reporter_.Progress(task, static_cast<int64_t>(pairs.size()), static_cast<int64_t>(pairs.size()));
  }
  return result;
}

VerifiedPair SplitMatching::Verify(const ImagePairMatches& pair, const std::vector<int>& subset) const {
  const Keypoints& keypoints1 = keypoints_[pair.image1];
  const Keypoints& keypoints2 = keypoints_[pair.image2];
  VerifiedPair verified;
  verified.image1 = pair.image1;
  verified.image2 = pair.image2;
  const TwoViewMotion motion = FitMotion(keypoints1, keypoints2, pair.matches, subset, settings_.motion);
  if (motion.inliers.empty()) return verified;
  verified.F = motion.F;
  verified.H = motion.H;
  verified.is_planar = motion.is_planar;
  const double probability =
      EpipolarInlierProbability(keypoints1, keypoints2, pair.matches, subset, settings_.motion.max_error_px);
  verified.log_false_alarms =
      LogFalseAlarms(static_cast<int>(motion.inliers.size()), static_cast<int>(subset.size()), probability);
  verified.matches.reserve(motion.inliers.size());
  for (const int m : motion.inliers) verified.matches.push_back(pair.matches[m]);
  return verified;
}

std::vector<VerifiedPair> SplitMatching::VerifyAll(const std::vector<ImagePairMatches>& pairs,
                                                   const std::vector<std::vector<int>>* subsets,
                                                   const char* task) {
  constexpr size_t kBlock = 64;  // pairs between two looks at whether to stop
  std::vector<VerifiedPair> verified(pairs.size());
  for (size_t begin = 0; begin < pairs.size(); begin += kBlock) {
    if (reporter_.StopRequested()) throw Interrupted();
    reporter_.Progress(task, static_cast<int64_t>(begin), static_cast<int64_t>(pairs.size()));
    const size_t end = std::min(begin + kBlock, pairs.size());
    ParallelFor(static_cast<int64_t>(end - begin), 0, [&](int64_t k) {
      const size_t p = begin + static_cast<size_t>(k);
      if (subsets != nullptr) {
        verified[p] = Verify(pairs[p], (*subsets)[p]);
        return;
      }
      std::vector<int> all(pairs[p].matches.size());
      std::iota(all.begin(), all.end(), 0);
      verified[p] = Verify(pairs[p], all);
    });
  }
  if (!pairs.empty()) {
    reporter_.Progress(task, static_cast<int64_t>(pairs.size()), static_cast<int64_t>(pairs.size()));
  }
  return verified;
}

}  // namespace s2gs
