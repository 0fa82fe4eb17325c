#pragma once

#include <Eigen/Core>
#include <functional>
#include <vector>

#include "sfm_split/base/rotation.h"
#include "sfm_split/joint_system/joint_problem.h"
#include "sfm_split/joint_system/wobble_harmonics.h"
#include "tests/support/synthetic_aligned_object.h"
#include "tests/support/synthetic_turntable.h"

namespace s2gs {

struct WobblingScan {
  static constexpr double kNoisePx = 0.4;
  JointProblem problem;
  std::vector<Rigid3> world_from_object;  ///< true, per image
};

/// What is done to the pure turn at an image: a tilt across the axis (z, through the origin) and a shift.
using WobbleAt = std::function<WobbleOfPose(size_t image, double angle_rad)>;

/// One station of 24 photos whose table wobbles, at each image but the reference. Of every second image `few`
/// keypoints at most are left. \param normal  draws of a standard normal distribution, for keypoints' noise.
inline WobblingScan MakeWobblingScan(uint32_t seed, int few, const std::function<double()>& normal,
                                     const WobbleAt& wobble_at) {
  SyntheticTurntableOptions options;
  options.seed = seed;
  options.stations = 1;
  options.steps = 24;
  options.step_deg = 15;
  options.num_object_points = 250;
  options.num_platter_points = 0;
  options.num_background_points = 0;
  const SyntheticTurntable turntable = MakeSyntheticTurntable(options);
  WobblingScan scan;
  scan.problem = MakeJointProblem(SyntheticAlignedObject(turntable));
  for (size_t i = 0; i < scan.problem.images.size(); ++i) {
    const Rigid3 turn = scan.problem.WorldFromObject(static_cast<int>(i));
    const WobbleOfPose wobble = wobble_at(i, scan.problem.images[i].angle_rad);
    const bool is_reference = static_cast<int>(i) == scan.problem.reference;
    const Rigid3 wobbled{Eigen::Quaterniond(ExpRotation<double>(wobble.tilt_rad)), wobble.shift};
    scan.world_from_object.push_back(is_reference ? turn : wobbled * turn);
  }
  std::vector<int> seen(scan.problem.images.size(), 0);
  std::vector<JointObservation> kept;
  for (JointObservation& observation : scan.problem.object.observations) {
    const auto i = static_cast<size_t>(observation.image);
    if (i % 2 == 1 && seen[i] >= few) continue;
    ++seen[i];
    const JointImage& image = scan.problem.images[i];
    const Eigen::Vector3d& x = scan.problem.object.points[static_cast<size_t>(observation.point)];
    observation.xy = *ProjectToImage(
        scan.problem.cameras[static_cast<size_t>(image.camera)],
        scan.problem.cam_from_world[static_cast<size_t>(image.pose)] * (scan.world_from_object[i] * x));
    const double x_noise = normal();
    observation.xy += WobblingScan::kNoisePx * Eigen::Vector2d(x_noise, normal());
    kept.push_back(observation);
  }
  scan.problem.object.observations = std::move(kept);
  return scan;
}

}  // namespace s2gs
