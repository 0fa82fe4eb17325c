#pragma once

#include <cmath>

#include "s2gs/core/host_device.h"
#include "s2gs/core/vec.h"

namespace s2gs {

/// Which Gaussians are drawn.
enum class DrawnBody { kAll, kForeground, kBackground };  ///< foreground: p >= tau.

/// A cylinder about an axis.
template <typename T>
struct AxisCylinder {
  Vec3<T> point, direction;  ///< of the axis; direction of unit length.
  T radius = 0;              ///< 0: nothing is inside.
  T low = 0, high = 0;       ///< along the axis from its point.
};

/// A tube about an axis, and the one colour that counts there.
template <typename T>
struct AxisTube {
  AxisCylinder<T> outer;
  T inner_radius = 0;
  Vec3<T> color;
  T color_tolerance = 0;  ///< mean over the channels.
};

template <typename T>
struct DrawnSelection {
  DrawnBody body = DrawnBody::kAll;
  AxisTube<T> side;                ///< static Gaussians in it, of its colour, count as rotating.
  AxisCylinder<T> without_static;  ///< other static Gaussians in it are not drawn.
};

template <typename T>
S2GS_HD inline bool Contains(const AxisCylinder<T>& cylinder, const Vec3<T>& x) {
  const Vec3<T> from_point = x - cylinder.point;
  const T height = Dot(from_point, cylinder.direction);
  const Vec3<T> from_axis = from_point - height * cylinder.direction;
  return height >= cylinder.low && height <= cylinder.high &&
         Dot(from_axis, from_axis) < cylinder.radius * cylinder.radius;
}

/// \param color  without its view-dependent part.
template <typename T>
S2GS_HD inline bool Contains(const AxisTube<T>& tube, const Vec3<T>& x, const Vec3<T>& color) {
  using std::abs;
  if (!Contains(tube.outer, x)) return false;
  const Vec3<T> from_point = x - tube.outer.point;
  const Vec3<T> from_axis = from_point - Dot(from_point, tube.outer.direction) * tube.outer.direction;
  if (Dot(from_axis, from_axis) < tube.inner_radius * tube.inner_radius) return false;
  const Vec3<T> apart = color - tube.color;
  return abs(apart.x) + abs(apart.y) + abs(apart.z) <= T(3) * tube.color_tolerance;
}

/// Whether a Gaussian counts as rotating in the map of the indicator.
/// \param centre  of the Gaussian, in the object's frame.
/// \param color  without its view-dependent part.
template <typename T>
S2GS_HD inline bool CountsAsRotating(const DrawnSelection<T>& selection, const Vec3<T>& centre,
                                     const Vec3<T>& color, bool is_foreground) {
  return is_foreground || Contains(selection.side, centre, color);
}

/// The parameters are CountsAsRotating's.
template <typename T>
S2GS_HD inline bool IsSelected(const DrawnSelection<T>& selection, const Vec3<T>& centre,
                               const Vec3<T>& color, bool is_foreground) {
  if (is_foreground) return selection.body != DrawnBody::kBackground;
  return selection.body != DrawnBody::kForeground &&
         (!Contains(selection.without_static, centre) || Contains(selection.side, centre, color));
}

}  // namespace s2gs
