#include "sfm_split/split/static_labels.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <utility>
#include <vector>

#include "sfm_split/base/binomial_tail.h"
#include "sfm_split/split/pair_evidence.h"

namespace s2gs {
namespace {

// Of the keypoints that are said to stand still, those that only chance upon others of the same look.
constexpr double kMostByChance = 0.05;
constexpr int kAdoptingStations = 3;  // whose background a photo from a station of its own is compared with

// The keypoints that at least `needed` photos show unmoved, not all in a row, and more than chance makes them
// show, by Benjamini's and Hochberg's bound of false discoveries.
std::vector<uint32_t> KeypointsNotByChance(const StillSupport& still, int image, int needed) {
  const auto i = static_cast<size_t>(image);
  std::vector<std::pair<double, uint32_t>> by_chance;
  for (uint32_t k = 0; k < still.support[i].size(); ++k) {
    if (still.support[i][k] < needed || still.lingers[i][k]) continue;
    const double tail =
        BinomialTail(still.support[i][k], still.num_partners[i], static_cast<double>(still.chance[i][k]));
    by_chance.emplace_back(tail, k);
  }
  std::sort(by_chance.begin(), by_chance.end());
  const double of_each = kMostByChance / static_cast<double>(std::max<size_t>(1, still.support[i].size()));
  size_t count = by_chance.size();
  while (count > 0 && by_chance[count - 1].first > static_cast<double>(count) * of_each) --count;
  std::vector<uint32_t> found;
  for (size_t r = 0; r < count; ++r) found.push_back(by_chance[r].second);
  return found;
}

}  // namespace

StillSupport LabelStaticKeypoints(const SplitMatching& matching, MotionSplit* split) {
  StillSupport still =
      FindStillSupport(matching.images(), split->stations, matching.settings().station.max_unmoved_px);
  split->labels.resize(matching.images().size());
  for (int i = 0; i < matching.NumImages(); ++i) {
    const SplitImage& image = matching.images()[i];
    split->labels[i].assign(image.keypoints.size(), KeypointLabel::kUnknown);
    if (!image.given_labels.empty()) {
      split->labels[i] = image.given_labels;
      continue;
    }
    if (still.num_partners[i] == 0) continue;
    const int by_share = static_cast<int>(std::ceil(kMinStaticShare * still.num_partners[i]));
    const int by_count = std::min(matching.settings().split.min_static_support, still.num_partners[i] / 2);
    const int needed = std::max(by_share, std::max(1, by_count));
    for (const uint32_t k : KeypointsNotByChance(still, i, needed))
      split->labels[i][k] = KeypointLabel::kStatic;
  }
  return still;
}

void LabelPhotosOfTheirOwn(SplitMatching* matching, MotionSplit* split) {
  const auto& stations = split->stations.images;
  std::vector<int> large;
  for (const std::vector<int>& station : stations) {
    if (station.size() >= 2) large.push_back(station[station.size() / 2]);
  }
  std::vector<ImagePair> pairs;
  for (const std::vector<int>& station : stations) {
    const int image = station.front();
    if (station.size() >= 2 || !matching->images()[image].given_labels.empty()) continue;
    const size_t num = std::min<size_t>(kAdoptingStations, large.size());
    for (size_t s = 0; s < num; ++s) pairs.push_back(OrderedPair(image, large[s * large.size() / num]));
  }
  if (pairs.empty()) return;
  PackedImages packed;
  packed.reserve(matching->images().size());
  for (int i = 0; i < matching->NumImages(); ++i) {
    const bool alone = stations[split->stations.station_of_image[i]].size() < 2;
    packed.push_back(PackLabel(matching->images()[i], split->labels[i],
                               alone ? KeypointLabel::kUnknown : KeypointLabel::kStatic));
  }
  const auto matched = matching->Match(pairs, packed, "match single photos");
  for (const VerifiedPair& pair : matching->VerifyAll(matched, nullptr, "fit single photos")) {
    if (pair.matches.empty() || pair.log_false_alarms > kMaxLogFalseAlarms) continue;
    const bool first = stations[split->stations.station_of_image[pair.image1]].size() < 2;
    for (const FeatureMatch& match : pair.matches) {
      const int image = first ? pair.image1 : pair.image2;
      split->labels[image][first ? match.point2D_idx1 : match.point2D_idx2] = KeypointLabel::kStatic;
    }
  }
}

PackedDescriptors PackLabel(const SplitImage& image, const std::vector<KeypointLabel>& labels,
                            KeypointLabel label) {
  std::vector<uint32_t> rows;
  for (uint32_t k = 0; k < image.keypoints.size(); ++k) {
    if (labels[k] == label) rows.push_back(k);
  }
  return {image.descriptors.data(), image.keypoints.size(), rows};
}

}  // namespace s2gs
