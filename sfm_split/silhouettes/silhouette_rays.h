#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <optional>
#include <vector>

#include "sfm_split/base/rigid3.h"
#include "sfm_split/scene/camera_model.h"
#include "sfm_split/scene/scene.h"
#include "sfm_split/silhouettes/silhouette.h"

namespace s2gs {

// A ray through an outline meets the thing somewhere, and this place lies in the outlines of all other photos
// of it: in the visual hull. How far it lies outside at least says how much outlines contradict each other.

/// A photo with its outline, as it is placed against the object.
struct SilhouetteView {
  const Silhouette* silhouette = nullptr;
  const Camera* camera = nullptr;
  Rigid3 cam_from_object;
};

/// Of a photo to a place: no more is asked than outlines reach [px^2 of the pictures].
constexpr float kMostSquaredPx = Silhouette::kReachPx * Silhouette::kReachPx;

/// `start` and the squares of how far a place lies outside of the outlines, summed up until `bound` is
/// reached. \param but  a view that is not asked; views.size(): all are. [px^2 of the pictures]
float SquaredOutside(const std::vector<SilhouetteView>& views, size_t but, const Eigen::Vector3d& x_in_object,
                     float start, float bound);

/// The ray that a place of a photo sees, in the object's frame, and where it passes the axis.
struct AxisRay {
  Eigen::Vector3d origin;     ///< the camera's centre.
  Eigen::Vector3d direction;  ///< of unit length.
  double across_squared = 0;  ///< square of the direction's part across the axis.
  double nearest = 0;         ///< to the axis, in lengths of the direction.
  double distance = 0;        ///< from the axis there.
};

/// Nothing where the place has no ray, or one along the axis. \param xy  [px of the photo]
std::optional<AxisRay> RayPastAxis(const Camera& camera, const Rigid3& cam_from_object,
                                   const Eigen::Vector2d& xy, const TurntableAxis& axis);

/// Of the picture, at the axis [px per length].
double PxPerLength(const SilhouetteView& view, const TurntableAxis& axis);

/// How far from the axis the thing reaches, by the rays through outlines.
double ReachOf(const std::vector<SilhouetteView>& views, const TurntableAxis& axis);

/// Places on a ray, a pixel apart or closer as seen from beside, no farther from the axis than the thing
/// reaches. \param xy  [px of the photo]
std::vector<Eigen::Vector3d> PlacesOnRay(const SilhouetteView& view, const Eigen::Vector2d& xy,
                                         const TurntableAxis& axis, double reach);

}  // namespace s2gs
