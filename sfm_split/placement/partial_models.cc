#include "sfm_split/placement/partial_models.h"

#include <utility>

#include "sfm_split/scene/pose_error.h"

namespace s2gs {

int JoinPartialModels(const std::vector<ColmapModel>& models, ColmapModel* first) {
  int joined = 0;
  for (const ColmapModel& other : models) {
    std::vector<Eigen::Vector3d> in_other;
    std::vector<Eigen::Vector3d> in_first;
    for (const auto& [id, image] : other.images) {
      const auto shared = first->images.find(id);
      if (shared == first->images.end()) continue;
      in_other.push_back(CameraCentre(image.cam_from_world));
      in_first.push_back(CameraCentre(shared->second.cam_from_world));
    }
    if (in_other.size() < 3 || in_other.size() == other.images.size()) continue;
    const Sim3Fit fit = FitSim3(in_other, in_first);
    if (fit.status != FitStatus::kOk) continue;
    for (const auto& [id, image] : other.images) {
      if (first->images.count(id) > 0) continue;
      ColmapImage moved = image;
      const Sim3& first_from_other = fit.b_from_a;
      moved.cam_from_world.rotation =
          (image.cam_from_world.rotation * first_from_other.rotation.conjugate()).normalized();
      moved.cam_from_world.translation =
          -(moved.cam_from_world.rotation * (first_from_other * CameraCentre(image.cam_from_world)));
      for (ColmapPoint2D& point : moved.points2D) point.point3D_id = kInvalidPoint3DId;
      first->cameras.emplace(image.camera_id, other.cameras.at(image.camera_id));
      first->images[id] = std::move(moved);
      ++joined;
    }
  }
  return joined;
}

}  // namespace s2gs
