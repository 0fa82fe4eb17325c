#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cmath>
#include <optional>

#include "sfm_split/base/angles.h"
#include "sfm_split/rim/rim_search.h"

namespace s2gs {

/// How far poses may be wrong: focal length and height trade off up and down before the camera, its roll is
/// told well.
constexpr double kMostLean = 20 * kDegree;
constexpr double kMostRoll = 12 * kDegree;
constexpr double kMostAside = 0.3;      ///< of the radius of what turns.
constexpr double kLeastOfRadius = 0.5;  ///< of that radius: less is a foot.

/// What tells a circle: how its normal leans against the axis, up and down and to the side before the camera,
/// about the middle of what turns [rad]; where its middle lies, beside the axis and along it; its radius.
constexpr int kNumUnknowns = 5;
using CircleUnknowns = Eigen::Matrix<double, kNumUnknowns, 1>;

/// Circles near the axis as a camera sees them. Keeps references.
class SearchedCircles {
 public:
  /// \param scale  pixels of the photo per pixel of the picture.
  SearchedCircles(const RimView& view, const RimSearch& search, const Eigen::Vector2d& scale)
      : view_(view), search_(search), scale_(scale) {
    const Eigen::Vector3d& up = search.axis.direction;
    pivot_height_ = (search.low + search.high) / 2;
    pivot_ = search.axis.point + pivot_height_ * up;
    Eigen::Vector3d to_camera = CameraCentre(view.cam_from_world) - pivot_;
    to_camera -= to_camera.dot(up) * up;
    level_ = to_camera.norm() > 0 ? Eigen::Vector3d(to_camera.normalized()) : up.unitOrthogonal();
    right_ = up.cross(level_);
  }

  struct Frame {
    Eigen::Vector3d middle, right, level;
  };
  Frame FrameOf(const CircleUnknowns& x) const {
    const Eigen::Matrix3d turn = (Eigen::AngleAxisd(x(0), right_) * Eigen::AngleAxisd(x(1), level_)).matrix();
    Frame frame;
    frame.right = turn * right_;
    frame.level = turn * level_;
    frame.middle = pivot_ + x(2) * frame.right + (x(3) - pivot_height_) * (turn * search_.axis.direction);
    return frame;
  }
  /// [px of the picture, from its corner]
  std::optional<Eigen::Vector2d> Place(const Frame& frame, double radius, double phi) const {
    const std::optional<Eigen::Vector2d> xy = ProjectToImage(
        view_.camera,
        view_.cam_from_world * Eigen::Vector3d(frame.middle + radius * (std::cos(phi) * frame.right +
                                                                        std::sin(phi) * frame.level)));
    if (!xy) return std::nullopt;
    return Eigen::Vector2d(xy->cwiseQuotient(scale_));
  }
  /// A place and the direction across the circle's picture there, outwards.
  struct Crossing {
    Eigen::Vector2d xy, normal;
  };
  std::optional<Crossing> Cross(const Frame& frame, double radius, double phi) const {
    constexpr double kDelta = 1e-3;  // [rad], and of the radius: less than a pixel of a circle in a photo
    const std::optional<Eigen::Vector2d> here = Place(frame, radius, phi);
    const std::optional<Eigen::Vector2d> next = Place(frame, radius, phi + kDelta);
    const std::optional<Eigen::Vector2d> farther = Place(frame, radius * (1 + kDelta), phi);
    if (!here || !next || !farther) return std::nullopt;
    const Eigen::Vector2d tangent = *next - *here;
    Eigen::Vector2d normal = Eigen::Vector2d(-tangent.y(), tangent.x()).normalized();
    if (normal.dot(*farther - *here) < 0) normal = -normal;
    return Crossing{*here, normal};
  }
  /// Of the middle of what turns, before the camera.
  double DepthOfPivot() const { return (view_.cam_from_world * pivot_).z(); }

 private:
  const RimView& view_;
  const RimSearch& search_;
  Eigen::Vector2d scale_;
  double pivot_height_ = 0;
  Eigen::Vector3d pivot_, right_, level_;
};

}  // namespace s2gs
