#pragma once

#include <Eigen/Core>
#include <vector>

#include "sfm_split/base/rigid3.h"

namespace s2gs {

/// A match by its rays, z = 1.
struct RayMatch {
  Eigen::Vector3d first;
  Eigen::Vector3d second;
  double chance = 0;  ///< density of its error, were it wrong [1 / px].
};

/// How much better a relative pose explains matches of two photos than chance: the logarithm of the
/// likelihood ratio, at the share of right matches that makes it largest. A right match has an epipolar error
/// N(0, sigma).
double EpipolarGain(const std::vector<RayMatch>& matches, const Rigid3& second_from_first, double focal1_px,
                    double focal2_px, double sigma_px);

}  // namespace s2gs
