#pragma once

#include <sstream>
#include <string>

#include "sfm_split/scene/io/colmap_model.h"

namespace s2gs {

/// A small consistent model with every feature that the files have: several camera models, keypoints with and
/// without points, an image without keypoints, a point without track, names with spaces and folders.
inline ColmapModel ExampleModel() {
  ColmapModel model;
  model.cameras[1] = {1, CameraModelId::kSimpleRadial, 800, 600, {700.25, 400.5, 300.125, -0.0123}};
  model.cameras[4] = {
      4, CameraModelId::kOpenCV, 4000, 3000, {3.1e3, 3.2e3, 2e3, 1.5e3, 0.1, -0.2, 1e-3, -1e-4}};
  const auto pose = [](double angle, double x) {
    Rigid3 cam_from_world;
    cam_from_world.rotation = Eigen::AngleAxisd(angle, Eigen::Vector3d(0.3, -0.5, 0.7).normalized()) *
                              Eigen::Quaterniond::Identity();
    cam_from_world.translation = {x, 1.0 / 3, -2e-7};
    return cam_from_world;
  };
  model.images[1] = {1, "first.jpg", 1, pose(0.1, 1), {{{1.5, 2.25}, 10}, {{0.1, 0.2}, kInvalidPoint3DId}}};
  model.images[2] = {2, "sub folder/second one.png", 4, pose(-2, 0.5), {{{3999.5, 0.5}, 10}}};
  model.images[7] = {7, "no-keypoints.jpg", 4, pose(3, -4), {}};
  model.points3D[10] = {10, {0.1, -1e300, 5e-324}, {255, 0, 7}, 0.75, {{1, 0}, {2, 0}}};
  model.points3D[99] = {99, {1, 2, 3}, {1, 2, 3}, -1, {}};
  return model;
}

/// The same with two rigs, one of them of two cameras and an inertial sensor.
inline ColmapModel ExampleModelWithRigs() {
  ColmapModel model = ExampleModel();
  const ColmapSensor camera1{ColmapSensorType::kCamera, 1};
  const ColmapSensor camera4{ColmapSensorType::kCamera, 4};
  const ColmapSensor imu{ColmapSensorType::kImu, 3};
  Rigid3 camera4_from_rig;
  camera4_from_rig.rotation = Eigen::Quaterniond(0.5, -0.5, 0.5, 0.5);
  camera4_from_rig.translation = {0.25, 0, -1};
  model.rigs[2] = {2, camera1, {{camera4, camera4_from_rig}, {imu, std::nullopt}}};
  model.rigs[5] = {5, camera4, {}};
  const Rigid3 rig_from_world = model.images[1].cam_from_world;
  model.images[2].cam_from_world = camera4_from_rig * rig_from_world;
  model.frames[1] = {1, 2, rig_from_world, {{camera1, 1}, {camera4, 2}, {imu, 1000000000000}}};
  model.frames[3] = {3, 5, model.images[7].cam_from_world, {{camera4, 7}}};
  return model;
}

/// A writer's output as a string.
template <typename Items>
std::string Bytes(void (*write)(std::ostream&, ColmapFormat, const Items&), ColmapFormat format,
                  const Items& items) {
  std::ostringstream stream;
  write(stream, format, items);
  return stream.str();
}

}  // namespace s2gs
