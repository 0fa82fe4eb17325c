#pragma once

#include <Eigen/Core>
#include <optional>
#include <random>
#include <string>
#include <vector>

#include "sfm_split/single_axis/single_axis.h"

namespace s2gs {

/// A keypoint's ray.
struct AxisRay {
  Eigen::Vector3d in_cam;    ///< z = 1.
  Eigen::Vector3d in_world;  ///< the same direction.
};

struct RayMatch {
  AxisRay first;
  AxisRay second;
  int index;  ///< in the input's pair.
};

struct RayPair {
  int index;  ///< in the input.
  int image1;
  int image2;
  bool same_place;  ///< of the two cameras.
  double focal;     ///< [px], mean of both cameras.
  std::vector<RayMatch> matches;
};

struct RayCamera {
  Eigen::Matrix3d from_world;
  Eigen::Vector3d centre;
};

/// The input of SolveSingleAxis as rays, and where they say that the object is.
struct AxisRays {
  std::vector<RayCamera> cameras;  ///< one per image.
  std::vector<RayPair> pairs;      ///< those with enough matches, in random order of matches.
  Eigen::Vector3d target = Eigen::Vector3d::Zero();  ///< about where the images look.
  Eigen::Vector3d sight = Eigen::Vector3d::UnitZ();  ///< from the mean camera to the target.
  double radius = 0;                                 ///< of the object, about.
  bool scale_observable = false;  ///< false: all cameras are in one place, and the target at distance 1.

  /// Free parameters of the axis: its direction and its point across it.
  int AxisParameters() const { return scale_observable ? 4 : 3; }
};

/// Empty, with the reason, when there is nothing to find an axis from.
std::optional<AxisRays> CollectRays(const SingleAxisInput& input, const SingleAxisOptions& options,
                                    std::mt19937* rng, std::string* reason);

}  // namespace s2gs
