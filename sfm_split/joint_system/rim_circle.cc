#include "sfm_split/joint_system/rim_circle.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <tuple>
#include <utility>

#include "sfm_split/base/angles.h"
#include "sfm_split/base/infinity.h"
#include "sfm_split/joint_system/wobble_harmonics.h"

namespace s2gs {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr int kAround = 72;        // places of the circle, of which the nearest is where Newton's steps start
constexpr int kSteps = 5;          // of Newton's: to rounding
constexpr int kHeights = 60;       // that are tried, a factor of 1.12 from one to the next
constexpr double kNearest = 0.01;  // below the camera, over its distance from the axis' point
constexpr double kFarthest = 10;   // the same
constexpr int kRounds = 10;        // of Gauss and Newton's
constexpr double kSettled = 1e-10;  // relative change of both lengths

// The axis and what lies across it.
struct Frame {
  explicit Frame(const Eigen::Vector4d& axis)
      : length(std::sqrt(axis(0) * axis(0) + axis(1) * axis(1) + 1)),
        along(Vector3d(axis(0), axis(1), 1) / length),
        point(axis(2), axis(3), 0) {
    std::tie(across, beside) = AcrossAxis(along);
  }
  Vector3d Outwards(double phi) const { return std::cos(phi) * across + std::sin(phi) * beside; }
  Vector3d Around(double phi) const { return std::cos(phi) * beside - std::sin(phi) * across; }

  double length;
  Vector3d along;
  Vector3d point;
  Vector3d across, beside;
};

}  // namespace

std::optional<RimOffset> OffsetFromRim(const Camera& camera, const Rigid3& cam_from_world,
                                       const Eigen::Vector4d& axis, const RimCircle& circle,
                                       const Vector2d& place) {
  const Frame frame(axis);
  const Matrix3d R = cam_from_world.rotation.toRotationMatrix();
  Vector2d xy;
  Eigen::Matrix<double, 2, 3> by_x;
  IntrinsicsJacobian by_camera;
  const auto x_in_world = [&](double phi) -> Vector3d {
    return frame.point + circle.height * frame.along + circle.radius * frame.Outwards(phi);
  };
  const auto project = [&](double phi, bool with_derivatives) {
    return ProjectWithJacobians(camera.model, camera.params.data(), cam_from_world * x_in_world(phi), &xy,
                                with_derivatives ? &by_x : nullptr, with_derivatives ? &by_camera : nullptr);
  };
  double nearest = kInfinity;
  double phi = 0;
  for (int k = 0; k < kAround; ++k) {
    const double at = 2 * kPi * k / kAround;
    if (!project(at, false) || !((xy - place).squaredNorm() < nearest)) continue;
    nearest = (xy - place).squaredNorm();
    phi = at;
  }
  if (!std::isfinite(nearest)) return std::nullopt;
  for (int step = 0; step < kSteps; ++step) {
    if (!project(phi, true)) return std::nullopt;
    const Vector2d tangent = by_x * (R * (circle.radius * frame.Around(phi)));
    phi += std::clamp(tangent.dot(place - xy) / tangent.squaredNorm(), -kPi / kAround, kPi / kAround);
  }
  if (!project(phi, true)) return std::nullopt;
  const Vector2d tangent = (by_x * (R * (circle.radius * frame.Around(phi)))).normalized();
  // The nearest place moves along the curve as all else changes, which its normal does not see.
  const Eigen::Matrix<double, 1, 2> normal(-tangent.y(), tangent.x());
  RimOffset offset;
  offset.px = normal * (xy - place);
  const Vector3d outwards = frame.Outwards(phi);
  const Vector3d x_in_cam = cam_from_world * x_in_world(phi);
  const Eigen::Matrix<double, 1, 3> by_x_in_cam = normal * by_x;
  const Eigen::Matrix<double, 1, 3> by_x_in_world = by_x_in_cam * R;
  Matrix3d cross;
  cross << 0, -x_in_cam.z(), x_in_cam.y(), x_in_cam.z(), 0, -x_in_cam.x(), -x_in_cam.y(), x_in_cam.x(), 0;
  offset.by_pose.head<3>() = -by_x_in_cam * cross;
  offset.by_pose.tail<3>() = -by_x_in_world;
  for (int k = 0; k < 2; ++k) {
    // Of the axis' direction, and of what lies across it, which leans with it.
    const Vector3d along = (Vector3d::Unit(k) - frame.along(k) * frame.along) / frame.length;
    offset.by_axis(k) =
        by_x_in_world.dot(circle.height * along - circle.radius * outwards.dot(along) * frame.along);
    offset.by_axis(2 + k) = by_x_in_world(k);
  }
  offset.by_circle << by_x_in_world.dot(frame.along), by_x_in_world.dot(outwards);
  offset.by_camera = normal * by_camera;
  return offset;
}

std::optional<RimCircle> NearestRimCircle(const Camera& camera, const Rigid3& cam_from_world,
                                          const Eigen::Vector4d& axis, const std::vector<Vector2d>& places) {
  const Frame frame(axis);
  const Vector3d centre = CameraCentre(cam_from_world) - frame.point;
  const double camera_height = centre.dot(frame.along);
  // Where rays meet the plane a unit below the camera, from below it: at other planes as far as these are.
  std::vector<Vector3d> met;
  for (const Vector2d& place : places) {
    const std::optional<Vector3d> ray = UnprojectFromImage(camera, place);
    if (!ray) continue;
    const Vector3d direction = cam_from_world.rotation.conjugate() * *ray;
    const double down = -direction.dot(frame.along);
    if (down > 0) met.emplace_back(direction / down + frame.along);
  }
  if (met.size() < 3) return std::nullopt;
  const Vector3d foot = centre - camera_height * frame.along;
  RimCircle circle;
  double least = kInfinity;
  for (int k = 0; k < kHeights; ++k) {
    const double below =
        centre.norm() * kNearest * std::pow(kFarthest / kNearest, k / static_cast<double>(kHeights - 1));
    double sum = 0;
    double squares = 0;
    for (const Vector3d& unit : met) {
      const double radius = (foot + below * unit).norm();
      sum += radius;
      squares += radius * radius;
    }
    const auto num = static_cast<double>(met.size());
    // As the photo shows it: what lies farther below is seen smaller.
    const double spread = (squares / num - std::pow(sum / num, 2)) / (below * below);
    if (spread >= least) continue;
    least = spread;
    circle = {camera_height - below, sum / num};
  }
  for (int round = 0; round < kRounds; ++round) {
    Eigen::Matrix2d normal = Eigen::Matrix2d::Zero();
    Vector2d right = Vector2d::Zero();
    for (const Vector2d& place : places) {
      const std::optional<RimOffset> offset = OffsetFromRim(camera, cam_from_world, axis, circle, place);
      if (!offset) return std::nullopt;
      normal += offset->by_circle.transpose() * offset->by_circle;
      right -= offset->by_circle.transpose() * offset->px;
    }
    const Vector2d change = normal.ldlt().solve(right);
    if (!change.allFinite() || !(circle.radius + change(1) > 0)) return std::nullopt;
    circle.height += change(0);
    circle.radius += change(1);
    if (change.norm() <= kSettled * circle.radius) break;
  }
  return circle;
}

}  // namespace s2gs
