#include "sfm_split/silhouettes/silhouette_rays.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <optional>

#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kReachShare = 0.98;  // of the outlines' rays pass the axis nearer than the thing reaches
// A judgement: the last fiftieth of the rays reach a fifth farther at most.
constexpr double kReachMargin = 1.2;
constexpr double kDepthStepPx = 1;  // [px] that a place moves in a picture from the side
constexpr int kFewestDepths = 8;    // a judgement: of a thing that is small in the picture
constexpr int kMostDepths = 256;    // a judgement: bounds the time

}  // namespace

std::optional<AxisRay> RayPastAxis(const Camera& camera, const Rigid3& cam_from_object, const Vector2d& xy,
                                   const TurntableAxis& axis) {
  const std::optional<Vector3d> in_cam = UnprojectFromImage(camera, xy);
  if (!in_cam) return std::nullopt;
  AxisRay ray;
  ray.origin = CameraCentre(cam_from_object);
  ray.direction = (cam_from_object.rotation.inverse() * *in_cam).normalized();
  const Vector3d across = ray.direction - axis.direction * axis.direction.dot(ray.direction);
  ray.across_squared = across.squaredNorm();
  if (!(ray.across_squared > 1e-12)) return std::nullopt;
  const Vector3d from_axis = ray.origin - axis.point;
  const Vector3d to_origin = from_axis - axis.direction * axis.direction.dot(from_axis);
  ray.nearest = -to_origin.dot(across) / ray.across_squared;
  ray.distance = (to_origin + ray.nearest * across).norm();
  return ray;
}

float SquaredOutside(const std::vector<SilhouetteView>& views, size_t but, const Vector3d& x_in_object,
                     float start, float bound) {
  float sum = start;
  for (size_t k = 0; k < views.size() && sum < bound; ++k) {
    if (k == but || !views[k].silhouette->IsFound()) continue;
    const std::optional<Vector2d> xy =
        ProjectToImage(*views[k].camera, views[k].cam_from_object * x_in_object);
    if (!xy) continue;
    const float outside = views[k].silhouette->Outside(*xy);
    sum += outside * outside;
  }
  return sum;
}

double PxPerLength(const SilhouetteView& view, const TurntableAxis& axis) {
  return FocalLengths(*view.camera).mean() / view.silhouette->photo_px.mean() /
         std::max(1e-12, (view.cam_from_object * axis.point).norm());
}

double ReachOf(const std::vector<SilhouetteView>& views, const TurntableAxis& axis) {
  std::vector<double> distances;
  for (const SilhouetteView& view : views) {
    for (const Vector2d& xy : view.silhouette->rim) {
      if (const auto ray = RayPastAxis(*view.camera, view.cam_from_object, xy, axis))
        distances.push_back(ray->distance);
    }
  }
  return distances.empty() ? 0 : kReachMargin * Quantile(std::move(distances), kReachShare);
}

std::vector<Vector3d> PlacesOnRay(const SilhouetteView& view, const Vector2d& xy, const TurntableAxis& axis,
                                  double reach) {
  const auto ray = RayPastAxis(*view.camera, view.cam_from_object, xy, axis);
  if (!ray || ray->distance > reach) return {};
  const double px_per_length = PxPerLength(view, axis);
  const double half = std::sqrt(reach * reach - ray->distance * ray->distance);
  const int num =
      std::clamp(static_cast<int>(2 * half * px_per_length / kDepthStepPx), kFewestDepths, kMostDepths);
  std::vector<Vector3d> places;
  for (int k = 0; k < num; ++k) {
    const double at = ray->nearest + half * (2 * (k + 0.5) / num - 1);
    if (at > 0) places.emplace_back(ray->origin + at * ray->direction);
  }
  return places;
}

}  // namespace s2gs
