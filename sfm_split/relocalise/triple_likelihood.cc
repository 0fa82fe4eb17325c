#include "sfm_split/relocalise/triple_likelihood.h"

#include <Eigen/Dense>
#include <array>
#include <cmath>
#include <optional>
#include <vector>

#include "sfm_split/adjust/posed_images.h"
#include "sfm_split/base/infinity.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/circular_motion/match_mixture.h"
#include "sfm_split/scene/camera_model.h"
#include "sfm_split/scene/ray_meeting.h"

namespace s2gs {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

// What two photos see at their keypoints, in the body.
std::optional<Vector3d> Meet(const PosedImage& a, const Vector2d& xy_a, const PosedImage& b,
                             const Vector2d& xy_b) {
  const std::optional<Vector3d> in_a = UnprojectFromImage(*a.camera, xy_a);
  const std::optional<Vector3d> in_b = UnprojectFromImage(*b.camera, xy_b);
  if (!in_a || !in_b) return std::nullopt;
  return MeetingOfRays<double>(CameraCentre(a.cam_from_body), a.cam_from_body.rotation.conjugate() * *in_a,
                               CameraCentre(b.cam_from_body), b.cam_from_body.rotation.conjugate() * *in_b);
}

// How far the middle keypoint lies along the outer ones' move from where they see it; infinite where they see
// nothing.
double ErrorOfMiddle(const std::array<const PosedImage*, 3>& posed, const std::array<Vector2d, 3>& xy) {
  const Vector2d move = xy[2] - xy[0];
  const std::optional<Vector3d> x = Meet(*posed[0], xy[0], *posed[2], xy[2]);
  if (!x || !(move.norm() > 0)) return kInfinity;
  const std::optional<Vector2d> seen = ProjectToImage(*posed[1]->camera, posed[1]->cam_from_body * *x);
  return seen ? move.normalized().dot(*seen - xy[1]) : kInfinity;
}

}  // namespace

double GainOfTriples(const ScanFeatures& features, const AlignedScene& aligned,
                     const std::vector<PhotoTriple>& triples, double sigma_px) {
  const std::vector<PosedImage> posed = PosedImages(features, aligned.scene, true);
  const double noise = kNoiseOfMiddle * sigma_px;
  const double peak = 1 / (noise * kRootTwoPi);
  double gain = 0;
  for (const PhotoTriple& triple : triples) {
    std::array<const PosedImage*, 3> of{};
    for (size_t k = 0; k < 3; ++k) of[k] = &posed[static_cast<size_t>(triple.images[k])];
    if (!of[0]->is_posed || !of[1]->is_posed || !of[2]->is_posed) continue;
    std::vector<double> over;  // density of a right one's error over that of a wrong one's
    for (const MatchTriple& match : triple.matches) {
      const double ratio = ErrorOfMiddle(of, KeypointsOf(features, triple, match)) / noise;
      const double right = std::isfinite(ratio) ? peak * std::exp(-0.5 * ratio * ratio) : 0;
      over.push_back(right / match.chance);
    }
    gain += MixtureGain(over, RightShare(over));
  }
  return gain;
}

}  // namespace s2gs
