#include "sfm_split/single_axis/single_axis_rays.h"

#include <Eigen/Dense>
#include <algorithm>
#include <numeric>
#include <utility>

#include "sfm_split/base/statistics.h"
#include "sfm_split/scene/camera_model.h"
#include "sfm_split/solvers/eigen_solvers.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

// Rays of less parallax than this [rad] between all cameras: one place.
constexpr double kLeastParallax = 2e-3;

// At most `max_matches` of the input's pair `index`, at random.
RayPair RaysOfPair(const SingleAxisInput& input, int index, const std::vector<RayCamera>& cameras,
                   int max_matches, std::mt19937* rng) {
  const SingleAxisPair& given = input.pairs[index];
  RayPair pair{};
  pair.index = index;
  pair.image1 = given.image1;
  pair.image2 = given.image2;
  const Camera& camera1 = input.cameras[input.images[given.image1].camera];
  const Camera& camera2 = input.cameras[input.images[given.image2].camera];
  pair.focal = 0.25 * (FocalLengths(camera1).sum() + FocalLengths(camera2).sum());
  std::vector<int> order(given.matches.size());
  std::iota(order.begin(), order.end(), 0);
  std::shuffle(order.begin(), order.end(), *rng);
  for (const int k : order) {
    const std::optional<Vector3d> first = UnprojectFromImage(camera1, given.matches[k].first);
    const std::optional<Vector3d> second = UnprojectFromImage(camera2, given.matches[k].second);
    if (!first || !second) continue;
    RayMatch match;
    match.first = {*first, cameras[pair.image1].from_world.transpose() * *first};
    match.second = {*second, cameras[pair.image2].from_world.transpose() * *second};
    match.index = k;
    pair.matches.push_back(match);
    if (static_cast<int>(pair.matches.size()) == max_matches) break;
  }
  return pair;
}

// The point closest to the images' mean rays, and how wide the rays scatter; false when they meet nowhere.
bool FindTarget(AxisRays* rays) {
  std::vector<Vector3d> sums(rays->cameras.size(), Vector3d::Zero());
  for (const RayPair& pair : rays->pairs) {
    for (const RayMatch& match : pair.matches) {
      sums[pair.image1] += match.first.in_world.normalized();
      sums[pair.image2] += match.second.in_world.normalized();
    }
  }
  Matrix3d normal = Matrix3d::Zero();
  Vector3d right = Vector3d::Zero();
  Vector3d mean_centre = Vector3d::Zero();
  Vector3d mean_ray = Vector3d::Zero();
  int count = 0;
  for (size_t i = 0; i < rays->cameras.size(); ++i) {
    if (sums[i].norm() == 0) continue;
    const Vector3d ray = sums[i].normalized();
    const Matrix3d across = Matrix3d::Identity() - ray * ray.transpose();
    normal += across;
    right += across * rays->cameras[i].centre;
    mean_centre += rays->cameras[i].centre;
    mean_ray += ray;
    ++count;
  }
  mean_centre /= count;
  double extent = 0;  // of the cameras' places
  for (size_t i = 0; i < rays->cameras.size(); ++i) {
    if (sums[i].norm() > 0) extent = std::max(extent, (rays->cameras[i].centre - mean_centre).norm());
  }
  mean_ray.normalize();
  // Rays of one place meet in the camera: what they look at has to lie well in front, seen from places that
  // differ.
  rays->target = normal.completeOrthogonalDecomposition().solve(right);
  const double depth = mean_ray.dot(rays->target - mean_centre);
  rays->scale_observable = rays->target.allFinite() && depth > 0 && extent > 1e-10 * mean_centre.norm() &&
                           extent > kLeastParallax * depth && depth > 0.1 * extent;
  if (!rays->scale_observable) rays->target = mean_centre + mean_ray;
  rays->sight = rays->target - mean_centre;
  const double distance = rays->sight.norm();
  if (!rays->target.allFinite() || distance == 0) return false;
  std::vector<double> spread;
  for (RayPair& pair : rays->pairs) {
    const double apart = (rays->cameras[pair.image1].centre - rays->cameras[pair.image2].centre).norm();
    pair.same_place = apart < 1e-6 * distance;
    const Vector3d mean = sums[pair.image1].normalized();
    for (const RayMatch& match : pair.matches) {
      spread.push_back(match.first.in_world.normalized().cross(mean).norm());
    }
  }
  rays->radius = 2 * UpperMedian(spread) * distance;
  return true;
}

}  // namespace

std::optional<AxisRays> CollectRays(const SingleAxisInput& input, const SingleAxisOptions& options,
                                    std::mt19937* rng, std::string* reason) {
  AxisRays rays;
  rays.cameras.reserve(input.images.size());
  for (const SingleAxisImage& image : input.images) {
    rays.cameras.push_back(
        {image.cam_from_world.rotation.toRotationMatrix(), CameraCentre(image.cam_from_world)});
  }
  for (size_t p = 0; p < input.pairs.size(); ++p) {
    const SingleAxisPair& given = input.pairs[p];
    if (given.image1 == given.image2 || static_cast<int>(given.matches.size()) < options.min_matches)
      continue;
    RayPair pair = RaysOfPair(input, static_cast<int>(p), rays.cameras, options.max_matches, rng);
    if (static_cast<int>(pair.matches.size()) >= options.min_matches) rays.pairs.push_back(std::move(pair));
  }
  if (rays.pairs.empty()) {
    *reason = "no pair of images has enough matches";
    return std::nullopt;
  }

  if (!FindTarget(&rays)) {
    *reason = "the cameras look at no common place";
    return std::nullopt;
  }
  return rays;
}

}  // namespace s2gs
