#pragma once

#include <Eigen/Core>
#include <atomic>
#include <cstdint>
#include <vector>

#include "sfm_split/adjust/track_triangulation.h"

namespace s2gs {

/// MatchErrorPx() of many matches: a keypoint's ray is found once, however many matches it has, and what two
/// photos' poses have in common once a pair. From several threads; the same bits.
class MatchErrors {
 public:
  /// \param images, keypoints  of each image, alike in number; must outlive it.
  MatchErrors(const std::vector<PosedImage>& images, std::vector<const Keypoints*> keypoints);

  /// Of two posed images' matches.
  std::vector<double> Of(int image1, int image2, const FeatureMatches& matches) const;
  /// Of all pairs'; none of pairs whose images are not both posed. Threads are taken here.
  std::vector<std::vector<double>> Of(const std::vector<ImagePairMatches>& pairs) const;

 private:
  enum State : uint8_t { kUnknown, kBeingFound, kFound, kNone };
  struct Ray {
    Eigen::Vector2d xy = Eigen::Vector2d::Zero();  // z = 1
    std::atomic<uint8_t> state{kUnknown};
  };

  // False where a pixel has none.
  bool RayOf(int image, uint32_t keypoint, Eigen::Vector3d* ray) const;

  const std::vector<PosedImage>& images_;
  std::vector<const Keypoints*> keypoints_;
  mutable std::vector<std::vector<Ray>> rays_;  // of posed images
};

}  // namespace s2gs
