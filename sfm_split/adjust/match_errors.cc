#include "sfm_split/adjust/match_errors.h"

#include <cstddef>
#include <optional>
#include <utility>

#include "sfm_split/base/error.h"
#include "sfm_split/base/infinity.h"
#include "sfm_split/base/parallel_for.h"

namespace s2gs {

using Eigen::Vector2d;
using Eigen::Vector3d;

MatchErrors::MatchErrors(const std::vector<PosedImage>& images, std::vector<const Keypoints*> keypoints)
    : images_(images), keypoints_(std::move(keypoints)), rays_(images.size()) {
  S2GS_INVARIANT(images_.size() == keypoints_.size());
  for (size_t i = 0; i < images_.size(); ++i) {
    if (images_[i].is_posed) rays_[i] = std::vector<Ray>(keypoints_[i]->size());
  }
}

bool MatchErrors::RayOf(int image, uint32_t keypoint, Vector3d* ray) const {
  const auto i = static_cast<size_t>(image);
  Ray& kept = rays_[i][keypoint];
  const uint8_t state = kept.state.load(std::memory_order_acquire);
  if (state == kNone) return false;
  if (state == kFound) {
    *ray << kept.xy, 1;
    return true;
  }
  const std::optional<Vector3d> found =
      UnprojectFromImage(*images_[i].camera, (*keypoints_[i])[keypoint].cast<double>());
  uint8_t unknown = kUnknown;
  // Who comes second finds it for itself alone.
  if (kept.state.compare_exchange_strong(unknown, kBeingFound, std::memory_order_relaxed)) {
    if (found) kept.xy = found->head<2>();
    kept.state.store(found ? kFound : kNone, std::memory_order_release);
  }
  if (found) *ray = *found;
  return found.has_value();
}

std::vector<double> MatchErrors::Of(int image1, int image2, const FeatureMatches& matches) const {
  const PairOfPoses poses(images_[static_cast<size_t>(image1)], images_[static_cast<size_t>(image2)]);
  std::vector<double> errors;
  errors.reserve(matches.size());
  for (const FeatureMatch& match : matches) {
    Vector3d ray1, ray2;
    const bool has_rays =
        RayOf(image1, match.point2D_idx1, &ray1) && RayOf(image2, match.point2D_idx2, &ray2);
    errors.push_back(has_rays ? poses.ErrorPx(ray1, ray2) : kInfinity);
  }
  return errors;
}

std::vector<std::vector<double>> MatchErrors::Of(const std::vector<ImagePairMatches>& pairs) const {
  std::vector<std::vector<double>> errors(pairs.size());
  ParallelFor(static_cast<int64_t>(pairs.size()), 0, [&](int64_t p) {
    const ImagePairMatches& pair = pairs[static_cast<size_t>(p)];
    const bool are_posed = images_[static_cast<size_t>(pair.image1)].is_posed &&
                           images_[static_cast<size_t>(pair.image2)].is_posed;
    if (are_posed) errors[static_cast<size_t>(p)] = Of(pair.image1, pair.image2, pair.matches);
  });
  return errors;
}

}  // namespace s2gs
