#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <utility>
#include <vector>

#include "sfm_split/base/rigid3.h"

namespace s2gs {

/// How much better a relative pose explains matches of two photos than chance: the logarithm of the
/// likelihood ratio, at the share of right matches that makes it largest. A right match has an epipolar error
/// N(0, sigma), a wrong one any error.
/// \param rays    z = 1, in the first and the second photo.
/// \param chance  density of a wrong match's error [1 / px].
/// \param stride  every so many matches count.
double EpipolarGain(const std::vector<std::pair<Eigen::Vector3d, Eigen::Vector3d>>& rays,
                    const Rigid3& second_from_first, double focal1_px, double focal2_px, double sigma_px,
                    double chance, size_t stride);

}  // namespace s2gs
