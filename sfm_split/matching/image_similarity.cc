#include "sfm_split/matching/image_similarity.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace s2gs {
namespace {

float SquaredScale(const KeypointMatrix& keypoints, Eigen::Index row) {
  if (keypoints.cols() == 4) return keypoints(row, 2) * keypoints(row, 2);
  if (keypoints.cols() == 6) {
    return std::abs(keypoints(row, 2) * keypoints(row, 5) - keypoints(row, 3) * keypoints(row, 4));
  }
  return 1.0F;
}

}  // namespace

std::vector<uint32_t> LargestKeypoints(const KeypointMatrix& keypoints, size_t num) {
  std::vector<uint32_t> rows(keypoints.rows());
  std::iota(rows.begin(), rows.end(), 0U);
  if (num >= rows.size()) return rows;
  // Scales that are not numbers would break the order: they count as the smallest.
  std::vector<float> scale(rows.size());
  for (size_t i = 0; i < scale.size(); ++i) {
    const float squared = SquaredScale(keypoints, static_cast<Eigen::Index>(i));
    scale[i] = std::isnan(squared) ? -1.0F : squared;
  }
  std::nth_element(
      rows.begin(), rows.begin() + static_cast<std::ptrdiff_t>(num), rows.end(),
      [&](uint32_t i, uint32_t j) { return scale[i] != scale[j] ? scale[i] > scale[j] : i < j; });
  rows.resize(num);
  std::sort(rows.begin(), rows.end());
  return rows;
}

SimilarityMatrix CountMatchesOfAllPairs(const std::vector<PackedDescriptors>& images,
                                        DescriptorMatcher* matcher, Reporter& reporter) {
  constexpr int64_t kMultiplyAddsPerBatch = 50'000'000'000;  // well under a second
  constexpr size_t kPairsPerBatch = 4096;                    // between two looks at whether to stop
  const auto num = static_cast<uint32_t>(images.size());
  const int64_t num_pairs = int64_t{num} * (int64_t{num} - 1) / 2;
  SimilarityMatrix similarity = SimilarityMatrix::Zero(num, num);
  std::vector<DescriptorMatcher::Job> jobs;
  std::vector<ImagePair> pairs;
  std::vector<FeatureMatches> matches;
  int64_t work = 0;
  int64_t num_done = 0;
  const auto flush = [&] {
    if (reporter.StopRequested()) throw Interrupted();
    matcher->MatchAll(jobs, &matches);
    for (size_t k = 0; k < pairs.size(); ++k) {
      const auto count = static_cast<uint32_t>(matches[k].size());
      similarity(pairs[k].first, pairs[k].second) = similarity(pairs[k].second, pairs[k].first) = count;
    }
    num_done += static_cast<int64_t>(pairs.size());
    reporter.Progress("compare images", num_done, num_pairs);
    jobs.clear();
    pairs.clear();
    work = 0;
  };
  for (uint32_t i = 0; i < num; ++i) {
    for (uint32_t j = i + 1; j < num; ++j) {
      jobs.push_back({&images[i], &images[j]});
      pairs.push_back({i, j});
      work += static_cast<int64_t>(images[i].size() * images[j].size()) * kDescriptorSize;
      if (work >= kMultiplyAddsPerBatch || jobs.size() >= kPairsPerBatch) flush();
    }
  }
  if (!jobs.empty()) flush();
  return similarity;
}

SimilarityMatrix CoarseSimilarity(const ColmapDatabase& database, const std::vector<uint32_t>& image_ids,
                                  size_t num_features, DescriptorMatcher* matcher, Reporter& reporter) {
  std::vector<PackedDescriptors> images;
  images.reserve(image_ids.size());
  for (const uint32_t image_id : image_ids) {
    if (reporter.StopRequested()) throw Interrupted();
    const DescriptorMatrix descriptors = database.ReadDescriptors(image_id);
    std::vector<uint32_t> rows = LargestKeypoints(database.ReadKeypoints(image_id), num_features);
    const auto beyond = std::lower_bound(rows.begin(), rows.end(), static_cast<uint32_t>(descriptors.rows()));
    rows.erase(beyond, rows.end());  // an image may have keypoints without descriptors
    images.emplace_back(descriptors.data(), static_cast<size_t>(descriptors.rows()), rows);
  }
  return CountMatchesOfAllPairs(images, matcher, reporter);
}

}  // namespace s2gs
