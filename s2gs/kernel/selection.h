#pragma once

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

template <typename T>
struct DrawnSelection {
  DrawnBody body = DrawnBody::kAll;
  AxisCylinder<T> without_static;  ///< static Gaussians in it are not drawn.
};

template <typename T>
S2GS_HD inline bool Contains(const AxisCylinder<T>& cylinder, const Vec3<T>& x) {
  const Vec3<T> from_point = x - cylinder.point;
  const T height = Dot(from_point, cylinder.direction);
  const Vec3<T> from_axis = from_point - height * cylinder.direction;
  return height >= cylinder.low && height <= cylinder.high &&
         Dot(from_axis, from_axis) < cylinder.radius * cylinder.radius;
}

/// \param centre  of the Gaussian, in the object's frame.
template <typename T>
S2GS_HD inline bool IsSelected(const DrawnSelection<T>& selection, const Vec3<T>& centre,
                               bool is_foreground) {
  if (is_foreground) return selection.body != DrawnBody::kBackground;
  return selection.body != DrawnBody::kForeground && !Contains(selection.without_static, centre);
}

}  // namespace s2gs
