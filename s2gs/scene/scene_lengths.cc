#include "s2gs/scene/scene_lengths.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <utility>
#include <vector>

#include "s2gs/backend/backend.h"
#include "sfm_split/base/rigid3.h"
#include "sfm_split/base/statistics.h"

namespace s2gs {
namespace {

// Where the cameras' axes meet, in the object's frame. Nothing when they are parallel.
std::optional<Eigen::Vector3d> AxesMeet(const std::vector<ScenePhoto>& photos) {
  constexpr double kMinSpread = 1e-3;  // of the axes, between 0 and 1 / 3.
  Eigen::Matrix3d normal_matrix = Eigen::Matrix3d::Zero();
  Eigen::Vector3d right_side = Eigen::Vector3d::Zero();
  for (const ScenePhoto& photo : photos) {
    const Eigen::Vector3d axis = photo.view.cam_from_object.rotation.conjugate() * Eigen::Vector3d::UnitZ();
    const Eigen::Vector3d centre = CameraCentre(photo.view.cam_from_object);
    const Eigen::Matrix3d across = Eigen::Matrix3d::Identity() - axis * axis.transpose();
    normal_matrix += across;
    right_side += across * centre;
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(normal_matrix);
  if (eigen.eigenvalues()[0] <= kMinSpread * eigen.eigenvalues()[2]) return std::nullopt;
  return normal_matrix.ldlt().solve(right_side);
}

void FindFocus(TrainingScene* scene) {
  const std::optional<Eigen::Vector3d> focus = AxesMeet(scene->photos);
  if (!focus) return;
  std::vector<double> radii;
  radii.reserve(scene->photos.size());
  for (const ScenePhoto& photo : scene->photos) {
    const PinholeView& view = photo.view;
    const double depth = (view.cam_from_object * *focus).z();
    const double half_angle_tan = std::max(view.width / view.fx, view.height / view.fy) / 2;
    if (depth > 0) radii.push_back(depth * std::sin(std::atan(half_angle_tan)));
  }
  if (2 * radii.size() < scene->photos.size()) return;  // they look away from each other
  scene->focus = *focus;
  scene->focus_radius = Quantile(std::move(radii), 0.5);
}

// Where the cameras look: the median rotating point, else the median point, else where their axes meet.
Eigen::Vector3d LookAt(const TrainingScene& scene) {
  const bool any_rotates =
      std::any_of(scene.points.begin(), scene.points.end(), [](const ScenePoint& p) { return p.rotates; });
  std::array<std::vector<double>, 3> coordinates;
  for (const ScenePoint& point : scene.points) {
    if (point.rotates != any_rotates) continue;
    for (int i = 0; i < 3; ++i) coordinates[i].push_back(point.x[i]);
  }
  if (!coordinates[0].empty()) {
    return {Quantile(coordinates[0], 0.5), Quantile(coordinates[1], 0.5), Quantile(coordinates[2], 0.5)};
  }
  if (const std::optional<Eigen::Vector3d> meeting = AxesMeet(scene.photos)) return *meeting;
  // Parallel axes and no points: the distance is unknown, one unit does.
  const PinholeView& view = scene.photos.front().view;
  return CameraCentre(view.cam_from_object) +
         view.cam_from_object.rotation.conjugate() * Eigen::Vector3d::UnitZ();
}

Rigid3 NormalisePose(const Rigid3& pose, const Eigen::Vector3d& origin, double size) {
  return {pose.rotation, (pose.rotation * origin + pose.translation) / size};
}

}  // namespace

void NormaliseScene(TrainingScene* scene) {
  const Eigen::Vector3d look_at = LookAt(*scene);
  std::vector<double> distances;
  distances.reserve(scene->photos.size());
  for (const ScenePhoto& photo : scene->photos) {
    distances.push_back((CameraCentre(photo.view.cam_from_object) - look_at).norm());
  }
  const double size = Quantile(std::move(distances), 0.5);
  scene->origin = look_at;
  scene->size = size > 0 && std::isfinite(size) ? size : 1;
  FindFocus(scene);
  scene->focus = (scene->focus - scene->origin) / scene->size;
  scene->focus_radius /= scene->size;
  for (ScenePhoto& photo : scene->photos) photo.view = NormaliseView(photo.view, scene->origin, scene->size);
  for (ScenePoint& point : scene->points) point.x = (point.x - scene->origin) / scene->size;
  if (scene->axis) scene->axis->point = (scene->axis->point - scene->origin) / scene->size;
  if (scene->region) {
    scene->region->axis.point = (scene->region->axis.point - scene->origin) / scene->size;
    scene->region->radius /= scene->size;
    scene->region->low /= scene->size;
    scene->region->high /= scene->size;
  }
}

PinholeView NormaliseView(const PinholeView& view, const Eigen::Vector3d& origin, double size) {
  PinholeView normalised = view;
  normalised.cam_from_world = NormalisePose(view.cam_from_world, origin, size);
  normalised.cam_from_object = NormalisePose(view.cam_from_object, origin, size);
  return normalised;
}

Gaussians DenormaliseGaussians(Gaussians gaussians, const Eigen::Vector3d& origin, double size) {
  const auto log_size = static_cast<float>(std::log(size));
  for (size_t i = 0; i < gaussians.centre.size(); ++i) {
    gaussians.centre[i] = static_cast<float>(gaussians.centre[i] * size + origin[static_cast<int>(i % 3)]);
  }
  for (float& value : gaussians.log_scale) value += log_size;
  return gaussians;
}

Gaussians NormaliseGaussians(Gaussians gaussians, const Eigen::Vector3d& origin, double size) {
  const auto log_size = static_cast<float>(std::log(size));
  for (size_t i = 0; i < gaussians.centre.size(); ++i) {
    gaussians.centre[i] = static_cast<float>((gaussians.centre[i] - origin[static_cast<int>(i % 3)]) / size);
  }
  for (float& value : gaussians.log_scale) value -= log_size;
  return gaussians;
}

}  // namespace s2gs
