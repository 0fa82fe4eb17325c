#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"
#include "sfm_split/scene/scene.h"

namespace s2gs {

// What an object on a turntable tells of a camera is all of its pose but the turn about the table's axis.

/// The turn about the axis [rad] that brings a place into the half plane of another one.
inline double AngleAboutAxis(const TurntableAxis& axis, const Eigen::Vector3d& from,
                             const Eigen::Vector3d& to) {
  const Eigen::Vector3d& n = axis.direction;
  const Eigen::Vector3d u = from - axis.point;
  const Eigen::Vector3d v = to - axis.point;
  return std::atan2(n.dot(u.cross(v)), u.dot(v) - n.dot(u) * n.dot(v));
}

/// The table's angle [degrees, in (-180, 180]] that an object's pose shows: its turn about the axis since the
/// reference image, where the object's frame is the world's. A pose that is tilted or shifted besides has
/// that of the nearest pure turn.
inline double TableAngleDeg(const TurntableAxis& axis, const Rigid3& world_from_object) {
  return AngleAbout(axis.direction, world_from_object.rotation.toRotationMatrix()) / kDegree;
}

inline Rigid3 TurnAbout(const TurntableAxis& axis, double angle_rad) {
  const Eigen::Matrix3d turn = RotationAbout<double>(axis.direction, angle_rad);
  return {Eigen::Quaterniond(turn), axis.point - turn * axis.point};
}

/// Turns a camera about the axis, new cam_from_world = cam_from_world * turn, and its table angle back: what
/// it sees of the object stays.
inline void TurnView(const TurntableAxis& axis, double turn_rad, View* view) {
  const Rigid3 turned_from_world = TurnAbout(axis, turn_rad);
  view->cam_from_world = view->cam_from_world * turned_from_world;
  view->world_from_object = turned_from_world.Inverse() * view->world_from_object;
  view->angle_deg = WrapAngle(view->angle_deg * kDegree - turn_rad) / kDegree;
}

/// Whether two cameras differ by no more than this in place, as a share of the distance from the axis, and in
/// direction [rad].
inline bool AreCamerasClose(const TurntableAxis& axis, const Rigid3& a, const Rigid3& b, double max_misfit) {
  const Eigen::Vector3d centre = CameraCentre(b);
  const double distance = (centre - axis.point).cross(axis.direction).norm();
  return (CameraCentre(a) - centre).norm() <= max_misfit * distance &&
         AngleBetween(a.rotation, b.rotation) <= max_misfit;
}

}  // namespace s2gs
