#pragma once

#include "s2gs/backend/backend.h"
#include "s2gs/core/pinhole_view.h"
#include "s2gs/kernel/surfel.h"

namespace s2gs {

// What both backends hand to the kernels for one view.

inline Mat3<float> ToMat3(const Eigen::Quaterniond& rotation) {
  const Eigen::Matrix3f m = rotation.toRotationMatrix().cast<float>();
  const auto column = [&m](int i) { return Vec3<float>{m(0, i), m(1, i), m(2, i)}; };
  return {column(0), column(1), column(2)};
}

inline Vec3<float> ToVec3(const Eigen::Vector3d& v) {
  return {static_cast<float>(v.x()), static_cast<float>(v.y()), static_cast<float>(v.z())};
}

inline SplatCamera<float> ToSplatCamera(const PinholeView& view) {
  return {ToMat3(view.cam_from_world.rotation),
          ToVec3(view.cam_from_world.translation),
          ToMat3(view.cam_from_object.rotation),
          ToVec3(view.cam_from_object.translation),
          static_cast<float>(view.fx),
          static_cast<float>(view.fy),
          static_cast<float>(view.cx),
          static_cast<float>(view.cy),
          static_cast<float>(view.near_depth),
          view.width,
          view.height};
}

inline ForegroundRule RuleFor(SceneBodies bodies, bool freeze_foreground) {
  switch (bodies) {
    case SceneBodies::kObjectOnly:
      return ForegroundRule::kObject;
    case SceneBodies::kStaticOnly:
      return ForegroundRule::kStatic;
    default:
      return freeze_foreground ? ForegroundRule::kHard : ForegroundRule::kSoft;
  }
}

}  // namespace s2gs
