#pragma once

#include <Eigen/Dense>
#include <cmath>

#include "sfm_split/base/rotation.h"
#include "tests/support/synthetic_turntable.h"

namespace s2gs {

/// Two stations of six photos: enough for what a synthetic scan must be.
inline SyntheticTurntableOptions SmallTurntable() {
  SyntheticTurntableOptions options;
  options.stations = 2;
  options.steps = 6;
  options.step_deg = 20;
  options.num_object_points = 300;
  options.num_platter_points = 80;
  options.num_background_points = 300;
  return options;
}

/// Distance [px] of a match's second keypoint from the epipolar line of its first, for a pinhole camera.
inline double EpipolarDistance(const SyntheticTurntable& turntable, const SyntheticPair& pair,
                               const SyntheticMatch& match, SyntheticBody body) {
  const Rigid3 cam2_from_cam1 =
      turntable.CamFromBody(pair.image2, body) * turntable.CamFromBody(pair.image1, body).Inverse();
  const Camera& camera = turntable.CameraOf(pair.image1);
  Eigen::Matrix3d k = Eigen::Matrix3d::Identity();
  k(0, 0) = k(1, 1) = camera.params[0];
  k(0, 2) = camera.params[1];
  k(1, 2) = camera.params[2];
  const Eigen::Matrix3d f = k.inverse().transpose() * CrossMatrix<double>(cam2_from_cam1.translation) *
                            cam2_from_cam1.rotation.toRotationMatrix() * k.inverse();
  const auto& keypoint1 = turntable.images[static_cast<size_t>(pair.image1)].keypoints[match.keypoint1];
  const auto& keypoint2 = turntable.images[static_cast<size_t>(pair.image2)].keypoints[match.keypoint2];
  const Eigen::Vector3d line = f * keypoint1.exact_xy.homogeneous();
  return std::abs(line.dot(keypoint2.exact_xy.homogeneous())) / line.head<2>().norm();
}

}  // namespace s2gs
