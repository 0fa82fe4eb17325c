#pragma once

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <random>
#include <utility>
#include <vector>

#include "sfm_split/adjust/joint_ba.h"
#include "sfm_split/base/angles.h"
#include "sfm_split/base/rotation.h"

namespace s2gs {

/// A turntable scene with exact or noisy observations. The anchor's pose and the held coordinate of the axis
/// are those of the truth, so that adjusted problems can be compared with it number by number.
struct JointScene {
  int stations = 3;
  int steps = 12;
  double step_deg = 30;
  int object_points = 150;
  int background_points = 150;
  double noise_px = 0;
  double drift_px = 0;  // of all keypoints of a point alike
  double outliers = 0;
  double shake = 0;       // of each image's camera, relative to the distance of 1
  double wobble_deg = 0;  // of the object at each image
  double elevation_step_deg = 12;
  double focal = 800;
  double visible = 0.5;  // share of the object's points that an image sees
  CameraModelId model = CameraModelId::kSimpleRadial;
  JointProblem truth;
  JointProblem start;

  void Build(uint32_t seed) {
    std::mt19937 rng(seed);
    std::normal_distribution<double> normal;
    std::uniform_real_distribution<double> uniform;
    const auto vector = [&] { return Eigen::Vector3d(normal(rng), normal(rng), normal(rng)); };
    truth = JointProblem();
    Camera camera;
    camera.camera_id = 1;
    camera.model = model;
    camera.width = 640;
    camera.height = 480;
    camera.params = {focal, 320, 240};
    if (model == CameraModelId::kPinhole) camera.params = {focal, focal, 320, 240};
    if (model == CameraModelId::kSimpleRadial) camera.params.push_back(0.03);
    truth.cameras = {camera};
    truth.axis << 0.02, -0.03, 0.01, 0.02;
    for (int i = 0; i < object_points; ++i) {
      // In a cylinder that fills about half of the image.
      const double extent = 0.3 * 320 / focal;
      truth.object.points.push_back(
          extent * Eigen::Vector3d(2 * uniform(rng) - 1, 2 * uniform(rng) - 1, 2 * uniform(rng) - 1));
    }
    for (int i = 0; i < background_points; ++i) {
      const Eigen::Vector3d direction = vector();
      const double extent = std::min(1.0, 400 / focal);  // a long lens sees little
      truth.background.points.push_back(
          extent * (Eigen::Vector3d(-0.8, 0, -0.3) + 0.5 * direction.cwiseMin(2).cwiseMax(-2)));
    }
    for (int s = 0; s < stations; ++s) {
      const double elevation = (20 + elevation_step_deg * s) * kDegree;
      const double azimuth = 8 * s * kDegree;
      const Eigen::Vector3d centre(std::cos(elevation) * std::cos(azimuth),
                                   std::cos(elevation) * std::sin(azimuth), std::sin(elevation));
      Eigen::Matrix3d world_from_cam;
      world_from_cam.col(2) = -centre.normalized();
      world_from_cam.col(0) = world_from_cam.col(2).cross(Eigen::Vector3d::UnitZ()).normalized();
      world_from_cam.col(1) = world_from_cam.col(2).cross(world_from_cam.col(0));
      truth.cam_from_world.push_back(Rigid3{Eigen::Quaterniond(world_from_cam), centre}.Inverse());
      for (int k = 0; k < steps; ++k) {
        JointImage image;
        image.name = "s" + std::to_string(s) + "_" + std::to_string(k);
        image.pose = s;
        image.angle_rad = WrapAngle(k * step_deg * kDegree);
        truth.images.push_back(image);
      }
    }
    std::map<std::pair<bool, int>, Eigen::Vector2d> drifts;
    for (int i = 0; i < static_cast<int>(truth.images.size()); ++i) {
      Rigid3 cam_from_world = truth.cam_from_world[truth.images[i].pose];
      if (i != truth.reference) {
        cam_from_world = Rigid3{Eigen::Quaterniond(ExpRotation<double>(shake * vector())), shake * vector()} *
                         cam_from_world;
      }
      Rigid3 world_from_object = truth.WorldFromObject(i);
      if (i != truth.reference) {
        world_from_object = Rigid3{Eigen::Quaterniond(ExpRotation<double>(wobble_deg * kDegree * vector())),
                                   Eigen::Vector3d::Zero()} *
                            world_from_object;
      }
      for (JointBody* body : {&truth.object, &truth.background}) {
        const bool of_object = body == &truth.object;
        for (int p = 0; p < static_cast<int>(body->points.size()); ++p) {
          if (of_object && uniform(rng) > visible) continue;
          Eigen::Vector3d x = body->points[p];
          if (of_object) x = world_from_object * x;
          const std::optional<Eigen::Vector2d> xy = ProjectToImage(camera, cam_from_world * x);
          if (!xy || (cam_from_world * x).z() < 0.1 || xy->x() < 0 || xy->y() < 0 || xy->x() > 640 ||
              xy->y() > 480) {
            continue;
          }
          JointObservation observation;
          observation.image = i;
          observation.point = p;
          observation.xy = *xy + noise_px * Eigen::Vector2d(normal(rng), normal(rng));
          if (drift_px > 0) {
            Eigen::Vector2d& drift =
                drifts.try_emplace({of_object, p}, Eigen::Vector2d::Zero()).first->second;
            if (drift.isZero()) drift = drift_px * Eigen::Vector2d(normal(rng), normal(rng));
            observation.xy += drift;
          }
          if (uniform(rng) < outliers) observation.xy += 40 * Eigen::Vector2d(normal(rng), normal(rng));
          body->observations.push_back(observation);
        }
      }
    }
    start = truth;
  }

  // Moves everything but the gauge.
  void Perturb(double amount, double focal_factor, uint32_t seed) {
    std::mt19937 rng(seed);
    std::normal_distribution<double> normal;
    const auto vector = [&] { return Eigen::Vector3d(normal(rng), normal(rng), normal(rng)); };
    for (size_t s = 1; s < start.cam_from_world.size(); ++s) {
      start.cam_from_world[s] =
          Rigid3{Eigen::Quaterniond(ExpRotation<double>(amount * vector())), amount * vector()} *
          start.cam_from_world[s];
    }
    for (size_t i = 1; i < start.images.size(); ++i) start.images[i].angle_rad += amount * normal(rng);
    start.axis(0) += amount * normal(rng);
    start.axis(1) += amount * normal(rng);
    start.axis(3) += amount * normal(rng);  // the anchor is farther in x: that coordinate is held
    for (Eigen::Vector3d& x : start.object.points) x += amount * vector();
    for (Eigen::Vector3d& x : start.background.points) x += amount * vector();
    start.cameras[0].params[0] *= focal_factor;
  }
};

/// Of two problems that differ by an adjustment: of all parameters, intrinsics in thousands of pixels.
inline double LargestDifference(const JointProblem& a, const JointProblem& b) {
  double worst = (a.axis - b.axis).cwiseAbs().maxCoeff();
  for (size_t s = 0; s < a.cam_from_world.size(); ++s) {
    worst = std::max(worst, AngleBetween(a.cam_from_world[s].rotation, b.cam_from_world[s].rotation));
    worst = std::max(worst, (CameraCentre(a.cam_from_world[s]) - CameraCentre(b.cam_from_world[s])).norm());
  }
  for (size_t i = 0; i < a.images.size(); ++i) {
    worst = std::max(worst, std::abs(WrapAngle(a.images[i].angle_rad - b.images[i].angle_rad)));
  }
  for (size_t c = 0; c < a.cameras.size(); ++c) {
    for (size_t k = 0; k < a.cameras[c].params.size(); ++k) {
      worst = std::max(worst, std::abs(a.cameras[c].params[k] - b.cameras[c].params[k]) / 1000);
    }
  }
  return worst;
}

/// As exact as double precision is.
inline JointOptions ExactJointOptions() {
  JointOptions options;
  options.function_tolerance = 1e-30;
  options.num_threads = 2;
  return options;
}

}  // namespace s2gs
