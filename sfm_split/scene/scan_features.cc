#include "sfm_split/scene/scan_features.h"

namespace s2gs {

bool HasPriorFocal(const ScanFeatures& features, uint32_t camera_id) {
  const auto has_prior = features.has_prior_focal.find(camera_id);
  return has_prior != features.has_prior_focal.end() && has_prior->second;
}

bool IsStatic(const ScanImage& image, uint32_t keypoint) {
  return keypoint < image.labels.size() && image.labels[keypoint] == KeypointLabel::kStatic;
}

std::map<int, int> SizesOfStations(const ScanFeatures& features) {
  std::map<int, int> sizes;
  for (const ScanImage& image : features.images) ++sizes[image.station];
  return sizes;
}

const std::vector<ImagePairMatches>& AllPairs(const ScanFeatures& features) {
  return features.raw_pairs.empty() ? features.object_pairs : features.raw_pairs;
}

std::vector<const Keypoints*> AllKeypoints(const ScanFeatures& features) {
  std::vector<const Keypoints*> keypoints;
  keypoints.reserve(features.images.size());
  for (const ScanImage& image : features.images) keypoints.push_back(&image.keypoints);
  return keypoints;
}

FeatureMatches PossibleObjectMatches(const ScanFeatures& features, const ImagePairMatches& pair) {
  const ScanImage& first = features.images[static_cast<size_t>(pair.image1)];
  const ScanImage& second = features.images[static_cast<size_t>(pair.image2)];
  FeatureMatches possible;
  for (const FeatureMatch& match : pair.matches) {
    if (IsStatic(first, match.point2D_idx1) || IsStatic(second, match.point2D_idx2)) continue;
    const float moved = (first.keypoints[match.point2D_idx1] - second.keypoints[match.point2D_idx2]).norm();
    if (first.station == second.station && moved <= kLeastMovePx) continue;
    possible.push_back(match);
  }
  return possible;
}

}  // namespace s2gs
