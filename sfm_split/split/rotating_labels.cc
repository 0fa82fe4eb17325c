#include "sfm_split/split/rotating_labels.h"

#include <utility>

namespace s2gs {

void LabelRotatingKeypoints(const SplitMatching& matching, const std::vector<std::vector<int>>& still,
                            MotionSplit* split) {
  std::vector<std::vector<int>> votes(matching.images().size());
  for (size_t i = 0; i < votes.size(); ++i) votes[i].assign(matching.images()[i].keypoints.size(), 0);
  for (const VerifiedPair& pair : split->object_pairs) {
    for (const FeatureMatch& match : pair.matches) {
      ++votes[pair.image1][match.point2D_idx1];
      ++votes[pair.image2][match.point2D_idx2];
    }
  }
  const int needed = matching.settings().split.min_rotating_matches;
  for (size_t i = 0; i < votes.size(); ++i) {
    if (!matching.images()[i].given_labels.empty()) continue;
    for (size_t k = 0; k < votes[i].size(); ++k) {
      const int unmoved = still.empty() ? 0 : still[i][k];
      if (votes[i][k] >= needed && votes[i][k] > unmoved) {
        split->labels[i][k] = KeypointLabel::kRotating;
      } else if (votes[i][k] > 0 && split->labels[i][k] == KeypointLabel::kRotating) {
        split->labels[i][k] = KeypointLabel::kUnknown;
      }
    }
  }
  const auto rotates = [&](int image, uint32_t keypoint) {
    return split->labels[image][keypoint] == KeypointLabel::kRotating;
  };
  std::vector<VerifiedPair> kept;
  kept.reserve(split->object_pairs.size());
  for (VerifiedPair& pair : split->object_pairs) {
    FeatureMatches left;
    left.reserve(pair.matches.size());
    for (const FeatureMatch& match : pair.matches) {
      if (rotates(pair.image1, match.point2D_idx1) && rotates(pair.image2, match.point2D_idx2))
        left.push_back(match);
    }
    pair.matches = std::move(left);
    if (static_cast<int>(pair.matches.size()) >= matching.settings().motion.min_inliers)
      kept.push_back(std::move(pair));
  }
  split->object_pairs = std::move(kept);
}

}  // namespace s2gs
