#include "sfm_split/relocalise/triple_likelihood.h"

#include <Eigen/Dense>
#include <array>
#include <cmath>
#include <limits>
#include <map>
#include <optional>
#include <vector>

#include "sfm_split/adjust/posed_images.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/circular_motion/match_mixture.h"
#include "sfm_split/circular_motion/match_triples.h"
#include "sfm_split/scene/camera_model.h"

namespace s2gs {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

// Where two rays are nearest to each other, in the body; nothing where they are parallel or meet behind.
std::optional<Vector3d> Meet(const PosedImage& a, const Vector2d& xy_a, const PosedImage& b,
                             const Vector2d& xy_b) {
  const std::optional<Vector3d> in_a = UnprojectFromImage(*a.camera, xy_a);
  const std::optional<Vector3d> in_b = UnprojectFromImage(*b.camera, xy_b);
  if (!in_a || !in_b) return std::nullopt;
  const Vector3d centre_a = CameraCentre(a.cam_from_body);
  const Vector3d centre_b = CameraCentre(b.cam_from_body);
  const Vector3d ray_a = (a.cam_from_body.rotation.conjugate() * *in_a).normalized();
  const Vector3d ray_b = (b.cam_from_body.rotation.conjugate() * *in_b).normalized();
  const double cosine = ray_a.dot(ray_b);
  const double squared_sine = 1 - cosine * cosine;
  if (!(squared_sine > 1e-12)) return std::nullopt;
  const Vector3d between = centre_b - centre_a;
  const double along_a = (ray_a.dot(between) - cosine * ray_b.dot(between)) / squared_sine;
  const double along_b = (cosine * ray_a.dot(between) - ray_b.dot(between)) / squared_sine;
  if (!(along_a > 0 && along_b > 0)) return std::nullopt;
  return 0.5 * (centre_a + along_a * ray_a + centre_b + along_b * ray_b);
}

// How far the middle keypoint lies along the outer ones' move from where they see it; infinite where they see
// nothing.
double ErrorOfMiddle(const std::array<const PosedImage*, 3>& posed, const std::array<Vector2d, 3>& xy) {
  constexpr double kNone = std::numeric_limits<double>::infinity();
  const Vector2d move = xy[2] - xy[0];
  const std::optional<Vector3d> x = Meet(*posed[0], xy[0], *posed[2], xy[2]);
  if (!x || !(move.norm() > 0)) return kNone;
  const std::optional<Vector2d> seen = ProjectToImage(*posed[1]->camera, posed[1]->cam_from_body * *x);
  return seen ? move.normalized().dot(*seen - xy[1]) : kNone;
}

}  // namespace

double GainOfTriples(const ScanFeatures& features, const AlignedScene& aligned, double sigma_px) {
  const std::vector<PosedImage> posed = PosedImages(features, aligned.scene, true);
  const double noise = kNoiseOfMiddle * sigma_px;
  const double peak = 1 / (noise * kRootTwoPi);
  const std::vector<PhotoTriple> triples = PhotoTriples(features);
  std::map<int, std::vector<MiddleMove>> middles;  // by station
  for (const PhotoTriple& triple : triples) {
    for (const MatchTriple& match : triple.matches)
      middles[triple.station].push_back(MiddleOf(KeypointsOf(features, triple, match)));
  }
  std::map<int, WrongMiddles> wrong;
  for (const auto& [station, of_station] : middles) wrong.emplace(station, WrongMiddles(of_station));
  double gain = 0;
  for (const PhotoTriple& triple : triples) {
    std::array<const PosedImage*, 3> of{};
    for (size_t k = 0; k < 3; ++k) of[k] = &posed[static_cast<size_t>(triple.images[k])];
    if (!of[0]->is_posed || !of[1]->is_posed || !of[2]->is_posed) continue;
    std::vector<double> over;  // density of a right one's error over that of a wrong one's
    for (const MatchTriple& match : triple.matches) {
      const std::array<Vector2d, 3> xy = KeypointsOf(features, triple, match);
      const double ratio = ErrorOfMiddle(of, xy) / noise;
      const double right = std::isfinite(ratio) ? peak * std::exp(-0.5 * ratio * ratio) : 0;
      over.push_back(right / wrong.at(triple.station).Chance(MiddleOf(xy)));
    }
    gain += MixtureGain(over, RightShare(over));
  }
  return gain;
}

}  // namespace s2gs
