#pragma once

#include <Eigen/Core>

#include "s2gs/core/gaussians.h"
#include "s2gs/core/pinhole_view.h"
#include "s2gs/scene/training_scene.h"

namespace s2gs {

/// Moves a scene into normalised lengths. Called by the readers; poses, points and region change.
void NormaliseScene(TrainingScene* scene);

/// Poses between the workspace's frame and the normalised one.
PinholeView NormaliseView(const PinholeView& view, const Eigen::Vector3d& origin, double size);
/// The model in the workspace's lengths, and back.
Gaussians DenormaliseGaussians(Gaussians gaussians, const Eigen::Vector3d& origin, double size);
Gaussians NormaliseGaussians(Gaussians gaussians, const Eigen::Vector3d& origin, double size);

}  // namespace s2gs
