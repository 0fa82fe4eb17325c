#pragma once

#include <cmath>

#include "s2gs/core/vec.h"
#include "s2gs/kernel/constants.h"
#include "s2gs/kernel/foreground.h"

namespace s2gs {

/// A view as the kernels need it. World and object are the frames of (7): B_t and F_t with the camera's pose.
template <typename T>
struct SplatCamera {
  Mat3<T> cam_from_world_rotation;
  Vec3<T> cam_from_world_translation;
  Mat3<T> cam_from_object_rotation;
  Vec3<T> cam_from_object_translation;
  T fx, fy, cx, cy;  ///< [px]
  T near_depth;      ///< nothing nearer is drawn.
  int width, height;
};

/// The geometry of one Gaussian in the optimiser's parameters: x, ln s, r, and the logits of alpha and p.
template <typename T>
struct SurfelParameters {
  Vec3<T> centre;
  Vec2<T> log_scale;
  Quat<T> rotation;
  T opacity_logit;
  T foreground_logit;
};

/// A surfel in the camera's frame.
template <typename T>
struct Surfel {
  Vec3<T> centre;
  Vec3<T> axis_u, axis_v;  ///< of unit length, orthogonal: the normal is axis_u x axis_v.
  Vec2<T> log_scale;
  T opacity;
  T foreground;            ///< p
  Vec3<T> view_direction;  ///< unit vector from the camera to the centre, in the body's own frame, for SH.
};

/// False when the parameters cannot be drawn: not finite, a quaternion without length, out of range. Then
/// `surfel` is not valid.
template <typename T>
S2GS_HD inline bool IsDrawable(const SurfelParameters<T>& g) {
  using std::abs;
  const T q2 = g.rotation.w * g.rotation.w + g.rotation.x * g.rotation.x + g.rotation.y * g.rotation.y +
               g.rotation.z * g.rotation.z;
  // Written so that NaN fails.
  return q2 > T(1e-30) && q2 < T(1e30) && abs(g.centre.x) < T(kMaxLength) &&
         abs(g.centre.y) < T(kMaxLength) && abs(g.centre.z) < T(kMaxLength) &&
         abs(g.log_scale.x) <= T(kMaxLogScale) && abs(g.log_scale.y) <= T(kMaxLogScale) &&
         abs(g.opacity_logit) < T(1e30) && abs(g.foreground_logit) < T(1e30);
}

/// A centre in the camera's frame (7): x_cam = p cam_from_object x + (1 - p) cam_from_world x.
/// \param p  0 or 1 where it is settled.
template <typename T>
S2GS_HD inline Vec3<T> CentreInCamera(const Vec3<T>& centre, T p, bool is_foreground,
                                      const SplatCamera<T>& camera, ForegroundRule rule) {
  if (rule == ForegroundRule::kSoft) {
    const Vec3<T> as_object = camera.cam_from_object_rotation * centre + camera.cam_from_object_translation;
    const Vec3<T> as_static = camera.cam_from_world_rotation * centre + camera.cam_from_world_translation;
    return p * as_object + (T(1) - p) * as_static;
  }
  return is_foreground ? camera.cam_from_object_rotation * centre + camera.cam_from_object_translation
                       : camera.cam_from_world_rotation * centre + camera.cam_from_world_translation;
}

/// The unit vector from the camera to a centre, in its body's own frame.
template <typename T>
S2GS_HD inline Vec3<T> ViewDirection(const Vec3<T>& centre_in_camera, bool is_foreground,
                                     const SplatCamera<T>& camera) {
  using std::sqrt;
  const Mat3<T>& body = is_foreground ? camera.cam_from_object_rotation : camera.cam_from_world_rotation;
  return TransposedTimes(body, (T(1) / sqrt(Dot(centre_in_camera, centre_in_camera))) * centre_in_camera);
}

/// Parameters -> surfel in the camera's frame. The centre is moved softly, by p (7); the rotation and the
/// view direction of SH are those of one body, by P = [p >= tau] (8, 9). False when the splat is not drawn:
/// parameters out of range, or the centre nearer than near_depth.
template <typename T>
S2GS_HD inline bool TransformSurfel(const SurfelParameters<T>& g, const SplatCamera<T>& camera,
                                    ForegroundRule rule, Surfel<T>* surfel) {
  using std::sqrt;
  if (!IsDrawable(g)) return false;
  const T p = ForegroundProbability(g.foreground_logit, rule);
  const bool is_foreground = IsForeground(g.foreground_logit, rule);  // (8)
  const Mat3<T>& body = is_foreground ? camera.cam_from_object_rotation : camera.cam_from_world_rotation;
  surfel->centre = CentreInCamera(g.centre, p, is_foreground, camera, rule);
  const T distance2 = Dot(surfel->centre, surfel->centre);
  if (!(surfel->centre.z >= camera.near_depth) || !(distance2 < T(kMaxLength * kMaxLength))) return false;
  const T inverse_length = T(1) / sqrt(g.rotation.w * g.rotation.w + g.rotation.x * g.rotation.x +
                                       g.rotation.y * g.rotation.y + g.rotation.z * g.rotation.z);
  const Mat3<T> own = RotationMatrix(g.rotation, inverse_length);
  surfel->axis_u = body * own.x;  // (9)
  surfel->axis_v = body * own.y;
  surfel->log_scale = g.log_scale;
  surfel->opacity = Sigmoid(g.opacity_logit);
  surfel->foreground = p;
  surfel->view_direction = ViewDirection(surfel->centre, is_foreground, camera);
  return true;
}

/// Adjoint of TransformSurfel, of a splat for which it returned true.
/// \param d  the loss by the surfel's fields.
/// \return   the loss by the parameters.
template <typename T>
S2GS_HD inline SurfelParameters<T> TransformSurfelAdjoint(const SurfelParameters<T>& g,
                                                          const SplatCamera<T>& camera, ForegroundRule rule,
                                                          const Surfel<T>& surfel, const Surfel<T>& d) {
  using std::sqrt;
  SurfelParameters<T> result;
  const bool is_foreground = IsForeground(g.foreground_logit, rule);
  const Mat3<T>& body = is_foreground ? camera.cam_from_object_rotation : camera.cam_from_world_rotation;

  // The view direction has unit length: only the part of its gradient across it moves the centre.
  const T inverse_distance = T(1) / sqrt(Dot(surfel.centre, surfel.centre));
  const Vec3<T> across =
      d.view_direction - Dot(d.view_direction, surfel.view_direction) * surfel.view_direction;
  const Vec3<T> d_centre = d.centre + inverse_distance * (body * across);

  T d_p = d.foreground;
  if (rule == ForegroundRule::kSoft) {
    const Vec3<T> as_object = camera.cam_from_object_rotation * g.centre + camera.cam_from_object_translation;
    const Vec3<T> as_static = camera.cam_from_world_rotation * g.centre + camera.cam_from_world_translation;
    d_p += Dot(d_centre, as_object - as_static);
    const T p = surfel.foreground;
    result.centre = p * TransposedTimes(camera.cam_from_object_rotation, d_centre) +
                    (T(1) - p) * TransposedTimes(camera.cam_from_world_rotation, d_centre);
    result.foreground_logit = d_p * SigmoidSlope(g.foreground_logit);
  } else {
    result.centre = TransposedTimes(body, d_centre);
    result.foreground_logit = T(0);
  }

  const T inverse_length = T(1) / sqrt(g.rotation.w * g.rotation.w + g.rotation.x * g.rotation.x +
                                       g.rotation.y * g.rotation.y + g.rotation.z * g.rotation.z);
  const Mat3<T> d_own = {
      TransposedTimes(body, d.axis_u), TransposedTimes(body, d.axis_v), {T(0), T(0), T(0)}};
  result.rotation = RotationMatrixAdjoint(g.rotation, inverse_length, d_own);
  result.log_scale = d.log_scale;
  result.opacity_logit = d.opacity * SigmoidSlope(g.opacity_logit);
  return result;
}

}  // namespace s2gs
