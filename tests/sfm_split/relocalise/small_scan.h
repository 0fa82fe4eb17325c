#pragma once

#include <Eigen/Geometry>
#include <algorithm>
#include <cstddef>
#include <iterator>
#include <map>
#include <string>
#include <vector>

#include "sfm_split/relocalise/scan_refinement.h"
#include "sfm_split/scene/pose_error.h"
#include "tests/support/synthetic_models.h"
#include "tests/support/synthetic_scan.h"

namespace s2gs {

inline SyntheticTurntableOptions SmallScan() {
  SyntheticTurntableOptions options;
  options.stations = 3;
  options.steps = 12;
  options.step_deg = 30;
  options.num_object_points = 250;
  options.num_platter_points = 100;
  options.num_background_points = 300;
  options.max_view_change_deg = 70;
  options.pixel_noise = 0.3;
  return options;
}

struct Figures {
  double rotation_max_deg = 0;
  double angle_max_deg = 0;
  double composition = 0;  // of cam_from_object against cam_from_world * world_from_object, in the models
};

inline Figures Measure(const SyntheticTurntable& turntable, const AlignedScene& aligned) {
  Figures figures;
  PoseMap estimate;
  PoseMap truth;
  std::map<std::string, const View*> truth_of;
  for (const View& view : turntable.scene.views) {
    truth[view.name] = view.CamFromObject();
    truth_of[view.name] = &view;
  }
  std::vector<Eigen::Quaterniond> estimated_turns;
  std::vector<Eigen::Quaterniond> true_turns;
  std::map<std::string, Rigid3> background;
  for (const auto& [id, image] : aligned.background.images) background[image.name] = image.cam_from_world;
  std::map<std::string, Rigid3> object;
  for (const auto& [id, image] : aligned.object.images) object[image.name] = image.cam_from_world;
  for (const View& view : aligned.scene.views) {
    estimate[view.name] = object.at(view.name);
    estimated_turns.push_back(view.world_from_object.rotation);
    true_turns.push_back(truth_of.at(view.name)->world_from_object.rotation);
    const Rigid3 composed =
        (background.empty() ? view.cam_from_world : background.at(view.name)) * view.world_from_object;
    figures.composition = std::max(figures.composition,
                                   (composed.Matrix() - object.at(view.name).Matrix()).cwiseAbs().maxCoeff());
  }
  const PoseErrors errors = ComparePoses(estimate, truth);
  for (const double error : errors.rotation_deg)
    figures.rotation_max_deg = std::max(figures.rotation_max_deg, error);
  for (const double error :
       TurntableAngleErrorsDeg(estimated_turns, true_turns, turntable.scene.axis.direction)) {
    figures.angle_max_deg = std::max(figures.angle_max_deg, error);
  }
  return figures;
}

/// Leaves the first points of a model alone.
inline void KeepPoints(size_t count, ColmapModel* model) {
  while (model->points3D.size() > count) model->points3D.erase(std::prev(model->points3D.end()));
  for (auto& [id, image] : model->images) {
    for (ColmapPoint2D& keypoint : image.points2D) {
      if (model->points3D.count(keypoint.point3D_id) == 0) keypoint.point3D_id = kInvalidPoint3DId;
    }
  }
}

/// The background's cameras of each station's first photo, a little wrong.
inline ColmapModel RoughBackground(const SyntheticTurntable& turntable, const ScanFeatures& features,
                                   uint32_t seed) {
  ColmapModel background = SyntheticStaticModel(turntable);
  ModelFaults faults;
  faults.rotation_deg = 0.15;
  faults.centre_rel = 0.003;
  DamageModel(faults, seed, &background);
  std::set<int> stations;
  std::vector<std::string> others;
  for (const ScanImage& image : features.images) {
    if (!stations.insert(image.station).second) others.push_back(image.name);
  }
  RemoveImages(others, &background);
  return background;
}

}  // namespace s2gs
